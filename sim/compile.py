"""Compilation of the Warp kernels, once, before jobs run side by side: cold starts in parallel are far slower."""

from __future__ import annotations

import argparse
import importlib

import warp as wp

from sim.kernels.lanes import WIDTHS, lane_module

_LANES = (
    "membrane",
    "bending",
    "tethers",
    "normals",
    "integrate",
    "contact",
    "kept_contacts",
    "query",
    "pokes",
    "strain",
)
_SELF_CONTACT = ("self_contact", "self_detection", "self_features", "untangle")
_PLAIN = ("contact", "seeds", "body_crossings")  # kernels that know no lanes
_PACKED = ("packed_membrane", "packed_bending", "packed_motion")
_IMPLICIT = tuple(
    f"sim.implicit.{name}" for name in ("force_kernels", "linear_system", "contact_kernels", "strain_limits")
)


def resolve_device(name: str) -> str:
    """Warp device for ``auto``, ``cpu`` or ``cuda``; raises ``ValueError`` where CUDA is asked for and missing."""
    _quiet()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    if name == "cuda":
        if not wp.is_cuda_available():
            raise ValueError("device 'cuda': Warp finds no CUDA device here; use auto or cpu")
        return "cuda:0"
    if name == "cpu":
        return "cpu"
    raise ValueError(f"device {name!r}: allowed are auto, cpu and cuda")


def compile_kernels(device: str = "auto") -> str:
    """Compile (or load from Warp's cache) every kernel module; returns the Warp device they were built for."""
    target = resolve_device(device)
    for width in WIDTHS:
        load_kernels(target, width)
    for name in (*_IMPLICIT, "geometry.surface_kernels"):  # the baseline and surface look-ups run on the CPU alone
        wp.load_module(importlib.import_module(name), device="cpu")
    return target


def load_kernels(warp_device: str, width: int) -> None:
    """Have the kernels for a number of worlds ready on a Warp device: a graph that is being recorded can load none."""
    for name in (*_LANES, *_SELF_CONTACT):
        importlib.import_module(f"sim.kernels.{name}")  # declares its instances
    lane_module(width).load(wp.get_device(warp_device))
    packed = _PACKED if warp_device == "cpu" and width == 1 else ()
    for name in (*_PLAIN, *packed):
        wp.load_module(importlib.import_module(f"sim.kernels.{name}"), device=warp_device)


def _quiet() -> None:
    # The banner and the note about a missing CUDA driver would fill every job's log.
    wp.config.log_level = wp.LOG_ERROR
    wp.init()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    print(compile_kernels(parser.parse_args().device))

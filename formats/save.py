"""Saving an animation: the ending of the path says the format.

=====================  ==========================================================================================
``.h5``                our own file, without loss (``formats.animation_file``)
``.glb``               glTF with morph targets, for Blender, three.js and the web (``formats.gltf``)
``.usd .usda .usdc``   USD with time samples (``formats.usd``)
``.obj``               a folder ``<name>_obj`` of one OBJ a mesh and frame (``formats.obj_sequence``)
``.pc2``               a folder ``<name>_pc2`` of a point cache and an OBJ a mesh (``formats.point_cache``)
``.mp4 .gif .png``     video, moving picture, sheet of frames (``formats.pictures``)
=====================  ==========================================================================================
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path

from formats.animation import Animation
from formats.target import refuse_existing

_WRITERS = {
    "h5": ("formats.animation_file", "write_animation_file"),
    "glb": ("formats.gltf", "write_glb"),
    "usd": ("formats.usd", "write_usd"),
    "usda": ("formats.usd", "write_usd"),
    "usdc": ("formats.usd", "write_usd"),
    "obj": ("formats.obj_sequence", "write_obj_sequence"),
    "pc2": ("formats.point_cache", "write_point_cache"),
    "mp4": ("formats.pictures", "write_mp4"),
    "gif": ("formats.pictures", "write_gif"),
    "png": ("formats.pictures", "write_sheet"),
}
_FOLDERS = {"obj": (".obj", ".mtl"), "pc2": (".pc2", ".obj", ".mtl")}

FORMATS = tuple(_WRITERS)
"""Names of the formats: endings without their dot."""


def save_animation(path: str | os.PathLike, animation: Animation, force: bool = False) -> Path:
    """Write an animation, whole or not at all.

    Args:
        path: Where to; its ending is one of ``FORMATS``.
        animation: What to write.
        force: Whether an earlier export may be replaced; else it is kept.

    Returns:
        The file, or the folder of a format that takes one.

    Raises:
        ValueError: Unknown ending, or something stands there that would be lost.
        OSError: It could not be written, for example for a full disk; nothing of it is left behind.
    """
    kind, target = _kind_and_target(path)
    module, function = _WRITERS[kind]
    getattr(importlib.import_module(module), function)(target, animation, force)
    return target


def check_target(path: str | os.PathLike, force: bool = False) -> None:
    """Raise the ``ValueError`` that :func:`save_animation` would raise for its path, before there is an animation."""
    kind, target = _kind_and_target(path)
    refuse_existing(target, force, folder=kind in _FOLDERS, suffixes=_FOLDERS.get(kind, ()))


def _kind_and_target(path: str | os.PathLike) -> tuple[str, Path]:
    path = Path(path)
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _WRITERS:
        raise ValueError(f"{path}: unknown format; a name must end in {', '.join('.' + name for name in FORMATS)}")
    return kind, path.with_name(f"{path.stem}_{kind}") if kind in _FOLDERS else path

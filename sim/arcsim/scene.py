"""A clip as a scene that ARCSim simulates: the folder with its JSON files and meshes.

The garment starts where its skinning weights put it in the first pose, stays there with the body for the settling time,
and then follows the clip. Everything is in SI units with y up, as here; times are simulated seconds, so that
``time_scale`` is in the frame time. Pins are handles, each a vertex on the path that skinning gives it. The body is
rigid segments (``sim.arcsim.body_segments``), which is the largest difference from what is simulated here; how large is
written into ``mapping.json`` with everything else that is not the same.

Files of a scene: ``scene.json``, ``material.json``, ``garment.obj``, ``segments/<joint>.obj`` and ``mapping.json``,
which ARCSim does not read. Paths inside are relative to the folder: the program is to be started there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import skin
from body.skeleton import JOINT_NAMES
from datasets.atomic import write_text
from sim.arcsim.body_segments import Segment, body_segments, segment_error
from sim.arcsim.flattening import flatten
from sim.arcsim.material import arcsim_material, arcsim_wind, never_yields
from sim.motion import checked_motion
from sim.parameters import check_parameters
from sim.rest_state import RestState

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

MODULES = (
    "proximity",
    "physics",
    "strainlimiting",
    "collision",
    "remeshing",
    "separation",
    "popfilter",
    "plasticity",
)
"""Parts of the program, in the order of its timing file."""


@dataclass(frozen=True)
class ArcsimSettings:
    """What a scene needs besides the clip and its parameters.

    Attributes:
        fps: Frames a second of the clip [1/s].
        steps_per_frame: Implicit steps a frame.
        settle_seconds: Simulated time in which the garment comes to rest on the first pose [s].
        strain_limits: Smallest and largest principal stretch; None for no limits.
        allowed_strain: Largest strain that laying the garment flat may put on a triangle.
        matched_speed: Speed against the air at which the normal drag is that of the parameters [m/s].
        collision_stiffness: Stiffness of its repulsion [N/m an area]; 1e6 as in the program's own scenes.
        handle_stiffness: Stiffness of the springs that hold the pins [N/m].
    """

    fps: float = 30.0
    steps_per_frame: int = 8
    settle_seconds: float = 1.0
    strain_limits: tuple[float, float] | None = None
    allowed_strain: float = 0.03
    matched_speed: float = 1.0
    collision_stiffness: float = 1.0e6
    handle_stiffness: float = 1.0e3

    def __post_init__(self) -> None:
        for name in ("fps", "allowed_strain", "matched_speed", "collision_stiffness", "handle_stiffness"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"arcsim settings: {name} = {getattr(self, name)}: must be above 0")
        if int(self.steps_per_frame) != self.steps_per_frame or self.steps_per_frame < 1:
            raise ValueError(f"arcsim settings: steps_per_frame = {self.steps_per_frame}: at least 1")
        if self.settle_seconds < 0.0:
            raise ValueError(f"arcsim settings: settle_seconds = {self.settle_seconds}: must not be negative")
        if self.strain_limits is not None:
            low, high = self.strain_limits
            if not 0.0 < low < 1.0 < high:
                raise ValueError(f"arcsim settings: strain_limits = {low}, {high}: must lie on both sides of 1")


@dataclass(frozen=True)
class ArcsimScene:
    """A scene on disk.

    Attributes:
        folder: Where its files are.
        vertices: Vertices of the garment.
        first_frame: Number of the program's frame that is the first recorded one.
        frames: Recorded frames.
        steps_per_frame: Implicit steps a frame.
        mapping: Content of ``mapping.json``.
    """

    folder: Path
    vertices: int
    first_frame: int
    frames: int
    steps_per_frame: int
    mapping: dict


def write_scene(
    folder: str | Path,
    template: GarmentTemplate,
    body: Body,
    pose: np.ndarray,
    root: np.ndarray,
    lead_in: int,
    parameters: Mapping[str, float],
    settings: ArcsimSettings | None = None,
) -> ArcsimScene:
    """Write all files of a scene; arguments as of :func:`sim.simulate.simulate_clip`.

    Raises:
        ValueError: Anything is wrong with the input: found before a file is written.
    """
    settings, folder = settings or ArcsimSettings(), Path(folder)
    pose, root = checked_motion(pose, root, lead_in, body, settings.fps)
    check_parameters(parameters)
    if template.body_digest != body.digest:
        raise ValueError(
            f"garment {template.name!r} was made for body {template.body_name!r} ({template.body_digest}), "
            f"not for {body.name!r} ({body.digest})"
        )
    rest = RestState.from_mesh(template.vertices, template.faces, template.pinned, template.pieces)
    flat, segments = flatten(rest, settings.allowed_strain), body_segments(body)
    transforms = body.joint_transforms(pose, root)
    start = skin(template.vertices, template.skin_index, template.skin_weight, transforms[:1])[0].astype(np.float64)
    frame_seconds = parameters["time_scale"] / settings.fps
    settling = int(np.ceil(settings.settle_seconds / frame_seconds - 1e-9))
    times = (settling + np.arange(len(pose))) * frame_seconds

    motions = [_rigid_motion(times, transforms[:, segment.joint]) for segment in segments]
    pinned = template.pinned
    paths = skin(rest.vertices[pinned], template.skin_index[pinned], template.skin_weight[pinned], transforms)
    handles = []
    for k, vertex in enumerate(pinned):
        handles.append({"nodes": [int(vertex)], "cloth": 0, "motion": len(motions)})
        motions.append(_path_motion(times, paths[:, k] - start[vertex]))
    scene = _simulation(parameters, settings, rest, frame_seconds, settling + len(pose) - 1)
    scene |= {
        "motions": motions,
        "handles": handles,
        "obstacles": [{"mesh": f"segments/{_segment_file(s)}", "motion": k} for k, s in enumerate(segments)],
    }
    # A few poses tell the error of the whole clip.
    sampled = np.unique(np.linspace(0, len(pose) - 1, 6).astype(int))
    mapping = {
        "garment": template.name,
        "body": body.name,
        "parameters": {name: float(value) for name, value in parameters.items()},
        "settings": asdict(settings),
        "vertices": len(rest.vertices),
        "first_recorded_frame": settling + lead_in,
        "recorded_frames": len(pose) - lead_in,
        "flattening": flat.figures(),
        "segments": segment_error(body, segments, pose[sampled], root[sampled]),
        "not_carried_over": _differences(parameters),
    }
    write_obj(folder / "garment.obj", start, template.faces, flat.uv, flat.corners)
    for segment in segments:
        write_obj(folder / "segments" / _segment_file(segment), segment.vertices, segment.faces)
    _write_json(folder / "material.json", arcsim_material(parameters))
    _write_json(folder / "mapping.json", mapping)
    _write_json(folder / "scene.json", scene)  # last: where it is, the scene is whole
    return ArcsimScene(
        folder, len(start), settling + lead_in, len(pose) - lead_in, int(settings.steps_per_frame), mapping
    )


def write_obj(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray | None = None,
    corners: np.ndarray | None = None,
) -> None:
    """Write a mesh; with ``uv [N, 2]`` its flat rest shape, ``corners [F, 3]`` saying which of them a corner has."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    if uv is None:
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    else:
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in uv.tolist()]
        pairs = zip((faces + 1).tolist(), (corners + 1).tolist())
        lines += ["f " + " ".join(f"{a}/{b}" for a, b in zip(face, corner)) for face, corner in pairs]
    write_text(path, "\n".join(lines) + "\n")


def _simulation(
    parameters: Mapping[str, float], settings: ArcsimSettings, rest: RestState, frame_seconds: float, end_frame: int
) -> dict:
    """The scene without its motions, handles and obstacles."""
    material: dict = {"data": "material.json", "damping": float(parameters["bend_damping"])}
    disabled = ["remeshing", "separation", "popfilter"]
    if settings.strain_limits is None:
        disabled.append("strainlimiting")
    else:
        material["strain_limits"] = list(settings.strain_limits)
    if never_yields(parameters):
        disabled.append("plasticity")
    else:
        material["yield_curv"] = float(parameters["bend_yield"])
    return {
        "frame_time": frame_seconds,
        "frame_steps": int(settings.steps_per_frame),
        "end_frame": end_frame,
        "cloths": [
            {
                "mesh": "garment.obj",
                "materials": [material],
                "remeshing": {
                    "refine_angle": 0.3,
                    "refine_compression": 0.005,
                    "refine_velocity": 0.5,
                    "size": [float(rest.edge_length.min()), float(rest.edge_length.max())],
                    "aspect_min": 0.2,
                },
            }
        ],
        "gravity": [0.0, -float(parameters["gravity"]), 0.0],
        "wind": arcsim_wind(parameters, settings.matched_speed),
        "friction": float(parameters["self_friction"]),
        "obs_friction": float(parameters["friction"]),
        "disable": disabled,
        "magic": {
            "fixed_high_res_mesh": True,
            "handle_stiffness": settings.handle_stiffness,
            "collision_stiffness": settings.collision_stiffness,
            "repulsion_thickness": float(parameters["thickness"]),
        },
    }


def _rigid_motion(times: np.ndarray, transforms: np.ndarray) -> list[dict]:
    """Keyframes of rigid transforms [T, 4, 4]; the first holds from time 0 on.

    The program blends quaternions component by component, so neighbours must have one sign: the angle leaves
    [0, 180] degrees where that is needed.
    """
    quaternion = Rotation.from_matrix(transforms[:, :3, :3]).as_quat()
    for k in range(1, len(quaternion)):
        if quaternion[k] @ quaternion[k - 1] < 0.0:
            quaternion[k] = -quaternion[k]
    keys = []
    for time, (x, y, z, w), place in zip(times, quaternion, transforms[:, :3, 3]):
        axis = np.array([x, y, z])
        sine = float(np.linalg.norm(axis))
        axis = axis / sine if sine > 1e-12 else np.array([0.0, 1.0, 0.0])
        angle = float(np.degrees(2.0 * np.arctan2(sine, w)))
        keys.append(_key(time, {"translate": _rounded(place), "rotate": _rounded([angle, *axis]), "scale": 1.0}))
    return _held_from_zero(keys)


def _path_motion(times: np.ndarray, offsets: np.ndarray) -> list[dict]:
    """Keyframes of translations [T, 3] from the start."""
    return _held_from_zero([_key(time, {"translate": _rounded(offset)}) for time, offset in zip(times, offsets)])


def _held_from_zero(keys: list[dict]) -> list[dict]:
    return keys if keys[0]["time"] <= 0.0 else [keys[0] | {"time": 0.0}, *keys]


def _key(time: float, transform: dict) -> dict:
    return {"time": round(float(time), 9), "transform": transform}


def _rounded(values: np.ndarray | list[float]) -> list[float]:
    return [round(float(value), 9) for value in values]


def _segment_file(segment: Segment) -> str:
    return f"{JOINT_NAMES[segment.joint]}.obj"


def _differences(parameters: Mapping[str, float]) -> dict[str, str]:
    """What the parameters say and the scene cannot, by name."""
    differences = {
        "substeps": "belongs to the XPBD solver; the scene has its own steps a frame",
        "compression": "compressed fabric is as stiff there as stretched fabric",
        "stretch_damping": "one time constant there for stretching and bending: bend_damping",
        "air_drag": "quadratic in the normal speed there; equal at the matched speed",
        "body": "rigid segments instead of skin; their distance from the skin stands under 'segments'",
    }
    if not never_yields(parameters):
        differences["bend_yield"] = "the program's own rule of plasticity beyond the same curvature"
    return differences


def _write_json(path: Path, content: dict) -> None:
    write_text(path, json.dumps(content, indent=1) + "\n")

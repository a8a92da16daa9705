"""Blender's cloth (``bpy``, GPL-3.0) on the scene: it runs in a process and an environment of its own.

Body and garment are mesh objects with absolute shape keys, one a frame: the body's carry the collider, the garment's
carry the pinned vertices. Frames are stepped with ``scene.frame_set``; nothing is drawn.

How the material is matched. Blender's cloth counts time in units of ``sqrt(0.001)`` s a frame whatever the frame rate
(measured: a free sheet falls by 0.0098 m a squared frame), and its stiffnesses follow, so that only ratios to the mass
of a vertex have a meaning; masses are given in grams.

==============  ======================================================================================================
ours            Blender
==============  ======================================================================================================
density         one mass for all vertices, the garment's over their number [g]
time_scale      a frame's ``1 / fps`` over the unit of time
stretch         tension over the mean edge length is a spring of ``sqrt(3)/2 stretch`` along every edge
shear           follows from the springs; shear springs exist on quads alone
compression     as stretch, for both
bend            angular springs with the force of a hinge of ``2/sqrt(3) bend`` on its outer vertices, but at rest in
                the garment's own shape: Blender cannot take a curved sheet as flat
damping         ``stretch_damping`` and ``bend_damping`` times the stiffness, up to Blender's largest (50)
air_drag        air viscosity, a force on every vertex alike
friction        of the collider, in percent
thickness       distance of the collision, besides Blender's smallest outer thickness of the body (1 mm)
==============  ======================================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.peers.recording import PeerMissing, PeerRun, record
from benchmarks.scene import SETTLE_SECONDS, Scene, hinge_stiffness, spring_stiffness

try:
    import bpy
except ImportError as error:
    raise PeerMissing(f"bpy: {error}") from error

TIME_UNIT = np.sqrt(1.0e-3)
"""Blender's unit of time in a cloth [s]."""

GRAMS = 1000.0


@dataclass(frozen=True)
class BlenderSettings:
    """Numbers of the method.

    Attributes:
        quality: Implicit steps a frame; Blender's default is 5.
        collision_quality: Passes of the collision response a step; Blender's default is 2.
    """

    quality: int = 5
    collision_quality: int = 2


def run(scene: Scene, settings: BlenderSettings = BlenderSettings()) -> PeerRun:
    """Simulate the scene with Blender's cloth modifier."""
    settle = round(SETTLE_SECONDS * scene.fps)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    stage = bpy.context.scene
    stage.gravity = (0.0, 0.0, -scene.parameters["gravity"])
    stage.render.fps = round(scene.fps)
    stage.frame_end = settle + len(scene.body)
    body = _animated("body", _z_up(scene.body), scene.body_faces, settle)
    _collider(body, scene)
    # Only pins move with the keys; where all other vertices stand is up to the cloth.
    keys = np.repeat(scene.vertices[None].astype(np.float32), len(scene.body), axis=0)
    keys[:, scene.pinned] = scene.pins
    garment = _animated("garment", _z_up(keys), scene.faces, settle)
    _cloth(garment, scene, settings, stage.frame_end)

    at = stage.frame_start
    stage.frame_set(at)
    count = len(scene.vertices)

    def step(start: int, end: int) -> None:
        nonlocal at
        at += 1
        stage.frame_set(at)

    def positions() -> np.ndarray:
        mesh = garment.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        flat = np.empty(count * 3, dtype=np.float32)
        mesh.vertices.foreach_get("co", flat)
        x, y, z = flat.reshape(-1, 3).T
        return np.stack([x, z, -y], axis=1)

    vertices, wall, cpu = record(scene, step, positions)
    words = f"quality {settings.quality}, collision quality {settings.collision_quality}"
    return PeerRun(f"Blender {bpy.app.version_string} cloth", words, settings.quality, vertices, wall, cpu)


def _z_up(points: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(np.asarray(points, dtype=np.float32), -1, 0)
    return np.stack([x, -z, y], axis=-1)


def _animated(name: str, frames: np.ndarray, faces: np.ndarray, settle: int) -> bpy.types.Object:
    """A mesh object that stands still for ``settle`` frames and then follows ``frames`` [T, N, 3], one a frame."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(frames[0].tolist(), [], faces.tolist())
    item = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(item)
    for frame in frames:
        block = item.shape_key_add(from_mix=False)
        block.interpolation = "KEY_LINEAR"
        block.data.foreach_set("co", frame.ravel())
    keys = mesh.shape_keys
    keys.use_relative = False
    times = [block.frame for block in keys.key_blocks]
    first = bpy.context.scene.frame_start
    for frame, value in ((first + settle, times[0]), (first + settle + len(frames) - 1, times[-1])):
        keys.eval_time = value
        keys.keyframe_insert("eval_time", frame=frame)
    for curve in keys.animation_data.action.fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    return item


def _collider(body: bpy.types.Object, scene: Scene) -> None:
    body.modifiers.new("collision", "COLLISION")
    body.collision.thickness_outer = 0.001
    body.collision.cloth_friction = 100.0 * scene.parameters["friction"]
    body.collision.damping = 0.0
    body.collision.use_culling = True


def _cloth(garment: bpy.types.Object, scene: Scene, settings: BlenderSettings, last_frame: int) -> None:
    p = scene.parameters
    edge = float(scene.edge_length.mean())
    area = float(scene.vertex_area.mean())
    # To Blender's units: time in TIME_UNIT, mass in grams.
    stiffness, rate = GRAMS * TIME_UNIT**2, GRAMS * TIME_UNIT
    spring = spring_stiffness(p["stretch"])
    height = np.sqrt(0.75) * edge
    hinge = hinge_stiffness(p["bend"]) / height  # force on the outer vertex an angle [N]

    modifier = garment.modifiers.new("cloth", "CLOTH")
    cloth, collision = modifier.settings, modifier.collision_settings
    cloth.quality = settings.quality
    cloth.mass = GRAMS * p["density"] * area
    cloth.time_scale = p["time_scale"] / (scene.fps * TIME_UNIT)
    cloth.tension_stiffness = cloth.compression_stiffness = spring * stiffness * edge
    cloth.tension_damping = cloth.compression_damping = min(50.0, spring * p["stretch_damping"] * rate)
    cloth.shear_stiffness = cloth.shear_damping = 0.0
    cloth.bending_model = "ANGULAR"
    cloth.bending_stiffness = hinge * stiffness / (0.1 * edge)
    cloth.bending_damping = min(50.0, hinge / height * p["bend_damping"] * rate)
    cloth.air_damping = 100.0 * p["air_drag"] * area * rate
    if len(scene.pinned):
        group = garment.vertex_groups.new(name="pinned")
        group.add(scene.pinned.tolist(), 1.0, "REPLACE")
        cloth.vertex_group_mass = group.name
    collision.use_collision = True
    collision.collision_quality = settings.collision_quality
    collision.distance_min = p["thickness"]
    collision.friction = 100.0 * p["friction"]
    collision.use_self_collision = scene.self_contact
    collision.self_distance_min = p["thickness"]
    collision.self_friction = 100.0 * p["self_friction"] if "self_friction" in p else 0.0
    modifier.point_cache.frame_start = bpy.context.scene.frame_start
    modifier.point_cache.frame_end = last_frame

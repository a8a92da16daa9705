"""How well XPBD and implicit Euler agree on the same material and scene: ``python -m benchmarks.agreement``.

Two methods that share nothing but the energies (``sim.implicit.energies``), the drag of the air and the distance that
cloth keeps from a body: where they meet, it is the equations that are solved and not a method's own habits. Scenes: a
strip that hangs by its upper edge (its sag is known), a sheet that is sheared by its weight, a sheet laid over a ball,
and a skirt, at rest and walking. Each is refined in substeps and in mesh size.

A scene must have one answer: cloth that buckles freely (a large limp sheet on a ball) falls into other folds at another
step of the same solver, and vertices of two solvers then lie centimetres apart though both are right.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from benchmarks.scene import FPS, LEAD_IN, motion
from body.model import Body
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from sim.implicit.settings import ImplicitSettings
from sim.implicit.simulate import simulate_clip_implicit
from sim.parameters import base_parameters
from sim.settings import SimulationSettings
from sim.simulate import simulate_clip

JOINTS = 24
WIND = {"wind_speed": 3.0, "wind_heading": 0.0, "air_drag": 1.0, "bend": 1e-3}
"""Parameters of a wind across the strip that lifts it by half its weight."""


@dataclass(frozen=True)
class Scene:
    """What both solvers are given.

    Attributes:
        template: Garment.
        body: Body that it is on.
        pose: Axis-angle poses [rad], shape [L + T, 24, 3].
        root: Root translations [m], shape [L + T, 3].
        lead_in: Number L of leading frames.
        parameters: Every intrinsic parameter but ``substeps``.
        settle_seconds: Time to come to rest before the first frame [s].
        contact: ``own`` or ``whole``, as in the solvers' settings.
    """

    template: GarmentTemplate
    body: Body
    pose: np.ndarray
    root: np.ndarray
    lead_in: int
    parameters: dict[str, float]
    settle_seconds: float = 1.5
    contact: str = "whole"

    def xpbd(self, substeps: int) -> np.ndarray:
        """Recorded frames of the XPBD solver [m], shape [T, V, 3]."""
        settings = SimulationSettings(
            fps=FPS,
            device="cpu",
            contact=self.contact,
            self_contact=False,  # the implicit solver has none
            tethers=False,  # nor these
            settle_seconds=self.settle_seconds,
            settle_speed=1e-4,
        )
        clip = (self.template, self.body, self.pose, self.root, self.lead_in)
        return _frames(simulate_clip(*clip, self.parameters | {"substeps": float(substeps)}, settings))

    def implicit(self, steps: int) -> np.ndarray:
        """Recorded frames of the implicit solver [m], shape [T, V, 3]."""
        settings = ImplicitSettings(
            fps=FPS,
            steps_per_frame=steps,
            cg_tolerance=1e-4,
            cg_max_iterations=2000,
            contact=self.contact,
            settle_seconds=self.settle_seconds,
            settle_speed=1e-4,
        )
        clip = (self.template, self.body, self.pose, self.root, self.lead_in)
        return _frames(simulate_clip_implicit(*clip, self.parameters, settings))


def _frames(result) -> np.ndarray:
    if result.failure is not None:
        raise ValueError(f"agreement: {result.failure}")
    return result.vertices.astype(np.float64)


def apart(first: np.ndarray, second: np.ndarray) -> float:
    """Root mean square distance of two results, over vertices and frames [m]."""
    return float(np.sqrt(((first - second) ** 2).sum(axis=-1).mean()))


# Scenes


def lattice(rows: int, columns: int, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Sheet of equilateral triangles in the x-z plane, rows along x, every second one shifted by half an edge.

    Returns:
        Vertices [m], shape [rows * columns, 3], and faces with normals along +y.
    """
    x, z = np.meshgrid(np.arange(rows) * edge * np.sqrt(0.75), np.arange(columns) * edge, indexing="ij")
    z[1::2] += 0.5 * edge
    number = np.arange(rows * columns).reshape(rows, columns)
    faces = []
    for i in range(rows - 1):
        low, high = number[i], number[i + 1]
        a, b, c, d = low[:-1], low[1:], high[:-1], high[1:]
        faces += [[a, b, c], [b, d, c]] if i % 2 == 0 else [[a, d, c], [a, b, d]]
    stacked = np.concatenate([np.stack(np.broadcast_arrays(*face), axis=1) for face in faces])
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1), stacked.astype(np.int32)


def rigid_body(vertices: np.ndarray, faces: np.ndarray, name: str) -> Body:
    """Any closed surface as a body that stands still."""
    count = len(vertices)
    return Body(
        name=name,
        vertices=np.asarray(vertices, dtype=np.float32),
        faces=np.asarray(faces, dtype=np.int32),
        joints=np.tile(np.float32([0.0, 0.0, 0.0]), (JOINTS, 1)),
        parents=np.array([-1] + [0] * (JOINTS - 1), dtype=np.int32),
        skin_index=np.zeros((count, 4), dtype=np.int32),
        skin_weight=np.tile(np.float32([1.0, 0.0, 0.0, 0.0]), (count, 1)),
        shape_basis=np.zeros((count, 3, 10), dtype=np.float32),
        joint_basis=np.zeros((JOINTS, 3, 10), dtype=np.float32),
        bind_rotation=np.tile(np.eye(3), (JOINTS, 1, 1)),
    )


def sheet_on(body: Body, vertices: np.ndarray, faces: np.ndarray, pinned: np.ndarray) -> GarmentTemplate:
    """A sheet as a garment of a rigid body."""
    count = len(vertices)
    return GarmentTemplate(
        name="sheet",
        kind="sheet",
        vertices=vertices.astype(np.float32),
        faces=faces,
        pinned=np.asarray(pinned, dtype=np.int32),
        skin_index=np.zeros((count, 4), dtype=np.int32),
        skin_weight=np.tile(np.float32([1.0, 0.0, 0.0, 0.0]), (count, 1)),
        body_name=body.name,
        body_digest=body.digest,
    )


def ball(radius: float, centre: tuple[float, float, float], subdivisions: int = 4) -> Body:
    """A ball that stands still."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return rigid_body(np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces), "ball")


def still(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A motion in which nothing moves."""
    return np.zeros((frames, JOINTS, 3)), np.zeros((frames, 3))


def hanging_strip(
    stretch: float, rows: int = 25, length: float = 0.6, settle_seconds: float = 2.0, **changes: float
) -> Scene:
    """A strip that hangs by its upper edge, far from any body.

    Args:
        stretch: Membrane stiffness [N/m].
        rows: Rows of vertices down the strip.
        length: Its length [m].
        settle_seconds: Time to come to rest [s].
        changes: Other parameters by name.
    """
    edge = length / ((rows - 1) * np.sqrt(0.75))
    vertices, faces = lattice(rows, 7, edge)
    vertices = np.stack([vertices[:, 2], -vertices[:, 0], vertices[:, 1]], axis=1)
    body = ball(0.1, (0.0, 1.5, 0.0), 1)
    template = sheet_on(body, vertices, faces, np.flatnonzero(vertices[:, 1] > -1e-9))
    parameters = base_parameters({"stretch": stretch, "shear": 0.3 * stretch} | changes)
    return Scene(template, body, *still(3), 0, parameters, settle_seconds)


def side_held_sheet(shear: float, rows: int = 13, length: float = 0.2, settle_seconds: float = 2.0) -> Scene:
    """An upright sheet held by one of its sides: its own weight shears it in its plane."""
    edge = length / ((rows - 1) * np.sqrt(0.75))
    vertices, faces = lattice(rows, 2 * rows, edge)
    vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    body = ball(0.1, (0.0, 1.5, 0.0), 1)
    template = sheet_on(body, vertices, faces, np.flatnonzero(vertices[:, 0] < 1e-9))
    parameters = base_parameters({"shear": shear})
    return Scene(template, body, *still(3), 0, parameters, settle_seconds)


def row_sags(scene: Scene, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each row of a hanging strip hangs below its place at rest [m], and what statics says."""
    rest = scene.template.vertices.astype(np.float64)
    depth = np.unique(-rest[:, 1].round(6))
    fallen = np.array([(rest[:, 1] - frame[:, 1])[np.abs(rest[:, 1] + d) < 1e-5].mean() for d in depth])
    weight, stretch = scene.parameters["density"] * scene.parameters["gravity"], scene.parameters["stretch"]
    # A section at depth y carries the cloth below it, so that the sag is the integral of weight (L - y) / stretch.
    return fallen, weight / stretch * (depth[-1] * depth - 0.5 * depth**2)


def draped_sheet(rows: int = 25, side: float = 0.5, settle_seconds: float = 2.0, **changes: float) -> Scene:
    """A square sheet laid on top of a ball of 15 cm."""
    edge = side / ((rows - 1) * np.sqrt(0.75))
    vertices, faces = lattice(rows, rows - 2, edge)
    body = ball(0.15, (0.0, -0.15, 0.0))
    gap = 0.003 + edge**2 / 0.4 + 0.0005
    vertices = vertices - vertices.mean(axis=0) + [0.0, gap, 0.0]
    template = sheet_on(body, vertices, faces, np.zeros(0))
    parameters = base_parameters({"bend": 1e-3, "friction": 0.6} | changes)
    return Scene(template, body, *still(3), 0, parameters, settle_seconds)


def skirt(vertices: int, frames: int, walking: bool, resolution: str = "small", **changes: float) -> Scene:
    """A skirt on a standing or walking body."""
    body = Body.load(resolution)
    template = build_template(GarmentSpec("skirt", "skirt", vertices), body)
    parameters = base_parameters({"bend": 1e-3} | changes)
    if walking:
        return Scene(template, body, *motion(body, frames), LEAD_IN, parameters, contact="own")
    pose = np.tile(body.bind_pose(), (frames, 1, 1))
    return Scene(template, body, pose, np.zeros((frames, 3)), 0, parameters, 2.5, "own")


# The table


@dataclass(frozen=True)
class Comparison:
    """One scene in all refinements.

    Attributes:
        name: Scene and mesh.
        vertices: Vertices of the cloth.
        moved: How far the cloth is from where it started [m], root mean square: what the differences compare with.
        steps: Steps a frame of the implicit reference.
        own: Distance of the reference from itself at half the steps [m].
        distance: By substeps of XPBD, distance of each vertex from the reference [m], shape [T, V].
        extrapolated: Distance of the reference from XPBD extrapolated to no substep, root mean square [m].
    """

    name: str
    vertices: int
    moved: float
    steps: int
    own: float
    distance: dict[int, np.ndarray]
    extrapolated: float


def compare(name: str, scene: Scene, substeps: tuple[int, ...], steps: int) -> Comparison:
    """Simulate a scene with both solvers; the reference is implicit Euler with ``steps`` a frame."""
    reference, coarse = scene.implicit(steps), scene.implicit(steps // 2)
    results = {n: scene.xpbd(n) for n in substeps}
    return Comparison(
        name=name,
        vertices=len(scene.template.vertices),
        moved=apart(reference, scene.template.vertices.astype(np.float64)),
        steps=steps,
        own=apart(reference, coarse),
        distance={n: np.linalg.norm(x - reference, axis=-1) for n, x in results.items()},
        extrapolated=apart(extrapolated(results), reference),
    )


def extrapolated(results: dict[int, np.ndarray]) -> np.ndarray:
    """Positions at infinitely many substeps, from the two finest: XPBD's error goes with the substep squared."""
    coarse, fine = sorted(results)[-2:]
    ratio = (fine / coarse) ** 2
    return (ratio * results[fine] - results[coarse]) / (ratio - 1.0)


def scenes(thorough: bool) -> dict[str, Scene]:
    """The scenes of the table by name, coarse and fine."""
    found: dict[str, Scene] = {}
    for stretch in (100.0, 1000.0, 10000.0):
        found[f"strip, {stretch:g} N/m, 25 rows"] = hanging_strip(stretch)
    for rows in (13, 49) if thorough else (13,):
        found[f"strip, 1000 N/m, {rows} rows"] = hanging_strip(1000.0, rows)
    found["strip in the wind, 3 m/s"] = hanging_strip(1000.0, 17, **WIND)
    found["sheet held by its side, 20 N/m"] = side_held_sheet(20.0)
    for rows in (13, 15, 23) if thorough else (13, 15):
        found[f"ball, {rows} rows, 1e-3 N m"] = draped_sheet(rows, 0.25, 3.0)
    found["ball, 13 rows, 1e-4 N m"] = draped_sheet(13, 0.25, 3.0, bend=1e-4)
    for count in (320, 600, 1300) if thorough else (320, 600):
        found[f"skirt at rest, {count} vertices"] = skirt(count, 2, walking=False)
        found[f"skirt walking, {count} vertices"] = skirt(count, 20, walking=True)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agreement", description=__doc__)
    parser.add_argument(
        "--substeps", type=int, nargs="+", default=[16, 32, 64, 128], help="of XPBD a frame, two or more"
    )
    parser.add_argument("--steps", type=int, default=16, help="of implicit Euler a frame, even")
    parser.add_argument("--thorough", action="store_true", help="finer meshes too: minutes instead of one")
    options = parser.parse_args()
    if len(set(options.substeps)) < 2 or min(options.substeps) < 1:
        parser.error("--substeps: two or more different numbers of at least 1 are needed")
    if options.steps < 2 or options.steps % 2:
        parser.error("--steps: an even number of at least 2 is needed")
    substeps = tuple(sorted(set(options.substeps)))
    print("Distance of XPBD from implicit Euler, root mean square over vertices and frames [mm] (95th percentile).")
    print(
        "own: of implicit Euler from itself at half the steps; inf: of XPBD extrapolated to infinitely many substeps.\n"
    )
    heads = [f"{n} substeps" for n in substeps]
    print(f"{'scene':34} {'moved':>7} {'own':>6} " + " ".join(f"{head:>15}" for head in heads) + f" {'inf':>7}")
    for name, scene in scenes(options.thorough).items():
        row = compare(name, scene, substeps, options.steps)
        cells = [
            f"{1e3 * np.sqrt((d**2).mean()):7.2f} ({1e3 * np.quantile(d, 0.95):5.1f})" for d in row.distance.values()
        ]
        text = f"{name:34} {1e3 * row.moved:7.1f} {1e3 * row.own:6.2f} " + " ".join(f"{cell:>15}" for cell in cells)
        print(f"{text} {1e3 * row.extrapolated:7.2f}", flush=True)


if __name__ == "__main__":
    main()

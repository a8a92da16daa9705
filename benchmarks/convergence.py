"""Does the simulator converge, in substeps and in mesh size? ``python -m benchmarks.convergence``.

Two scenes: a sheet that hangs from its upper edge, and a skirt on a walking body. XPBD with one iteration a substep
moves what a substep of gravity did to a row of cloth only one row farther, so cloth that hangs is longer than its
material makes it. Of a hanging sheet of n rows the surplus is about ``g dt^2 n^2 / 2`` (time step dt). The report tells
it from the material's own stretch in two ways:

- measured: lengths at two time steps, taken to ``dt -> 0`` along ``length = material + c dt^2`` (Richardson);
- known: a sheet of stiffness k under its own weight stretches by the load below each row over k.

Output: a table on the terminal, ``convergence.csv`` and ``convergence.png``. Lengths are those of one frame at rest
(sheet) or the mean of the recorded frames (skirt).
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from body.model import Body
from evaluation.table import Row, write_table
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from motions.lead_in import lead_in
from motions.procedural import generate_clip
from sim.compile import compile_kernels
from sim.parameters import base_parameters
from sim.rest_state import RestState
from sim.settings import SimulationSettings
from sim.simulate import Simulator

FPS, LEAD_IN, SEED = 30.0, 24, 20191
SUBSTEPS = (4, 8, 16, 32, 64, 128, 256)
SHEET_ROWS = (13, 25, 49)
SKIRT_VERTICES = (600, 1200, 2400)
MATERIAL = {"density": 0.2, "stretch": 1000.0, "shear": 300.0, "bend": 8.0e-5, "air_drag": 0.8}
"""A weave of middle weight, soft enough that its own stretch can be measured."""

SHEET_HEIGHT, SHEET_WIDTH = 0.48, 0.24  # [m]


@dataclass(frozen=True)
class Scene:
    """Something that hangs, and how it is looked at.

    Attributes:
        name: Name in the table.
        template: The garment.
        body: Body that it is pinned to and collides with.
        pose: Poses [rad], lead-in first, shape [L + T, 24, 3].
        root: Roots [m], shape [L + T, 3].
        lead_in: Number L.
        rows: Rows of cloth from the pins to the lower edge.
        settings: Settling, contact.
        parameters: Every intrinsic parameter; substeps are replaced.
    """

    name: str
    template: GarmentTemplate
    body: Body
    pose: np.ndarray
    root: np.ndarray
    lead_in: int
    rows: float
    settings: SimulationSettings
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """One scene at one number of substeps.

    Attributes:
        scene: The scene.
        substeps: Substeps a frame.
        vertices: Recorded frames [m], shape [T, V, 3].
        stretch: How much longer than at rest the cloth hangs, from the pins to the lower edge [m].
        p99_strain: 99th percentile of the edges' absolute strain [1].
        failure: Why the simulation failed, None where it did not.
    """

    scene: Scene
    substeps: int
    vertices: np.ndarray
    stretch: float
    p99_strain: float
    failure: str | None

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.scene.parameters["time_scale"] / (self.scene.settings.fps * self.substeps)


def hanging_sheet(
    rows: int, body: Body, height: float = SHEET_HEIGHT, width: float = SHEET_WIDTH, **values: float
) -> Scene:
    """A sheet of equilateral triangles that hangs from its upper edge, three metres in front of a standing body.

    Args:
        rows: Rows of triangles.
        body: Body that the pins are fixed to.
        height: Of the sheet [m].
        width: Of the sheet, to the next whole edge [m].
        values: Intrinsic parameters other than those of ``MATERIAL``.
    """
    step = height / rows
    edge = step / np.sqrt(0.75)
    columns = max(2, round(width / edge) + 1)
    row, column = np.divmod(np.arange((rows + 1) * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, 1.2 - row * step, np.full(row.shape, 3.0)], axis=1)
    faces = []
    for r in range(rows):
        for c in range(columns - 1):
            a, b = r * columns + c, r * columns + c + 1
            d, e = a + columns, b + columns
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    count = len(vertices)
    weight = np.zeros((count, 4))
    weight[:, 0] = 1.0
    template = GarmentTemplate(
        name=f"sheet of {rows} rows",
        kind="skirt",
        vertices=vertices,
        faces=np.array(faces),
        pinned=np.arange(columns),
        skin_index=np.zeros((count, 4), dtype=np.int32),
        skin_weight=weight,
        body_name=body.name,
        body_digest=body.digest,
    )
    # Long enough to come to rest: the sheet has nothing to do but hang.
    settings = SimulationSettings(
        fps=FPS,
        device="cpu",
        settle_seconds=3.0,
        settle_speed=2.0e-5,
        settle_damping=8.0,
        self_contact=False,
        tethers=False,  # they hide the artificial stretch that is measured here
    )
    parameters = base_parameters({**MATERIAL, **values})
    pose, root = np.repeat(body.bind_pose()[None], 2, axis=0), np.zeros((2, 3))
    return Scene("hanging sheet", template, body, pose, root, 1, rows, settings, parameters)


def walking_skirt(vertices: int, body: Body, frames: int = 30, label: str = "walk") -> Scene:
    """A skirt on a walking body."""
    template = build_template(GarmentSpec("skirt", "skirt", vertices, length=0.52, ease=0.01, flare=0.25), body)
    clip = generate_clip(label, 0, frames, FPS, SEED, body)
    lead_pose, lead_root = lead_in(clip, body, LEAD_IN)
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    settings = SimulationSettings(fps=FPS, device="cpu", settle_seconds=1.0)
    rest = RestState.from_mesh(template.vertices, template.faces, template.pinned)
    # Rows of an even mesh: its height over that of an equilateral triangle.
    rows = np.ptp(template.vertices[:, 1]) / (np.sqrt(0.75) * float(rest.edge_length.mean()))
    return Scene("walking skirt", template, body, pose, root, LEAD_IN, rows, settings, base_parameters(MATERIAL))


def simulate(scene: Scene, substeps: Sequence[int], done: Callable[[], None] | None = None) -> list[Run]:
    """The scene at each number of substeps."""
    simulator = Simulator(scene.template, scene.body, scene.settings)
    runs = []
    for count in substeps:
        result = simulator.run(scene.pose, scene.root, scene.lead_in, {**scene.parameters, "substeps": float(count)})
        strain = result.quality["p99_edge_strain"]
        runs.append(Run(scene, count, result.vertices, stretch_along(scene, result.vertices), strain, result.failure))
        if done is not None:
            done()
    return runs


def stretch_along(scene: Scene, vertices: np.ndarray) -> float:
    """How much longer the cloth is from the pins to the lower edge [m]: strain of the warp, averaged over the cloth,
    times its length. The warp is vertical in the rest shape."""
    rest = RestState.from_mesh(scene.template.vertices, scene.template.faces, scene.template.pinned)
    corners = np.asarray(vertices, dtype=np.float64)[:, rest.topology.faces]
    edges = np.stack([corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]], axis=-1)
    warp = np.linalg.norm(edges @ rest.inverse[:, :, 1:], axis=(-2, -1))  # [T, F]
    strain = ((warp - 1.0) * rest.area).sum(axis=1) / rest.area.sum()
    return float(strain.mean() * np.ptp(rest.vertices[:, 1]))


def material_stretch(scene: Scene) -> float:
    """Stretch of the hanging sheet by its material alone [m]: load below each row of triangles over stiffness.

    The masses are lumped at the vertices, as in the simulation; the continuous sheet has ``density g H^2 / (2 k)``.
    """
    rest = RestState.from_mesh(scene.template.vertices, scene.template.faces, scene.template.pinned)
    height = rest.vertices[:, 1]
    levels = np.unique(height.round(6))[::-1]
    values = scene.parameters
    total = 0.0
    for upper, lower in itertools.pairwise(levels):
        between = (upper + lower) / 2.0
        load = values["density"] * values["gravity"] * rest.vertex_area[height < between].sum()
        middle = rest.vertices[rest.topology.faces][..., 1].mean(axis=1)
        width = rest.area[(middle < upper) & (middle > lower)].sum() / (upper - lower)
        total += load * (upper - lower) / (values["stretch"] * width)
    return total


def artificial_stretch_law(run: Run) -> float:
    """The known law of the surplus: ``g dt^2 n^2 / 2`` [m], for n rows."""
    return 0.5 * run.scene.parameters["gravity"] * run.dt**2 * run.scene.rows**2


def extrapolated(runs: Sequence[Run]) -> float:
    """Stretch at ``dt -> 0`` [m], from the two runs with the smallest time steps."""
    fine, coarse = sorted((r for r in runs if r.failure is None), key=lambda r: r.dt)[:2]
    ratio = (coarse.dt / fine.dt) ** 2
    return (ratio * fine.stretch - coarse.stretch) / (ratio - 1.0)


def order_of_convergence(runs: Sequence[Run], material: float) -> float:
    """Power of the time step with which the surplus over the material's stretch falls: slope of the logarithms."""
    good = [r for r in runs if r.failure is None]
    x = np.log([r.dt for r in good])
    y = np.log([max(r.stretch - material, 1.0e-12) for r in good])
    return float(np.polyfit(x, y, 1)[0])


def apart(run: Run, finest: Run) -> float:
    """Root mean square distance from the finest run [m], in the last recorded frame.

    Compared is how far points of the cloth went from their rest place, so that meshes may differ: every vertex is
    followed to the closest point of the finest rest shape.
    """
    mine, other = run.scene.template, finest.scene.template
    moved = run.vertices[-1].astype(np.float64) - mine.vertices
    reference = finest.vertices[-1].astype(np.float64) - other.vertices
    if run.scene is not finest.scene:
        hits = closest_surface(mine.vertices.astype(np.float64), other.vertices.astype(np.float64), other.faces)
        reference = (reference[other.faces[hits.face]] * hits.barycentric[..., None]).sum(axis=1)
    return float(np.sqrt(((moved - reference) ** 2).sum(axis=1).mean()))


def report_rows(groups: Sequence[Sequence[Run]]) -> list[Row]:
    """The table, a row a run. A group is the runs of one scene on one mesh; a scene's last group is its finest."""
    rows: list[Row] = []
    for runs in groups:
        scene = runs[0].scene
        finest = next(g for g in reversed(groups) if g[0].scene.name == scene.name)[-1]
        material = extrapolated(runs)
        for run in runs:
            good = run.failure is None
            rows.append(
                {
                    "scene": scene.name,
                    "vertices": len(scene.template.vertices),
                    "rows": round(scene.rows, 1),
                    "substeps": run.substeps,
                    "dt_ms": 1e3 * run.dt,
                    "stretch_mm": 1e3 * run.stretch if good else None,
                    "artificial_mm": 1e3 * (run.stretch - material) if good else None,
                    "artificial_law_mm": 1e3 * artificial_stretch_law(run),
                    "material_extrapolated_mm": 1e3 * material,
                    "material_analytic_mm": 1e3 * material_stretch(scene) if scene.name == "hanging sheet" else None,
                    "p99_edge_strain_percent": 1e2 * run.p99_strain if good else None,
                    "from_finest_mm": 1e3 * apart(run, finest) if good else None,
                    "failure": run.failure or "",
                }
            )
    return rows


def printed(rows: Sequence[Row]) -> str:
    """The table as text for a terminal."""
    columns = [name for name in rows[0] if name != "failure"]
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    widths = [max(len(line[i]) for line in [columns, *cells]) for i in range(len(columns))]
    lines = ["  ".join(text.rjust(width) for text, width in zip(line, widths)) for line in [columns, *cells]]
    return "\n".join(lines)


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def convergence_figure(rows: Sequence[Row]):
    """Surplus and distance from the finest run against substeps, a line a mesh; dashed: the known law."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    panels = (("artificial_mm", "artificial stretch [mm]"), ("p99_edge_strain_percent", "p99 edge strain [%]"), ("from_finest_mm", "rms distance from the finest [mm]"))  # fmt: skip  # noqa: E501
    figure = Figure(figsize=(11.0, 3.3 * len(scenes)), layout="constrained")
    FigureCanvasAgg(figure)
    colours = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
    for line, scene in enumerate(scenes):
        mine = [row for row in rows if row["scene"] == scene]
        for column, (key, label) in enumerate(panels):
            axes = figure.add_subplot(len(scenes), len(panels), 1 + line * len(panels) + column)
            for colour, count in zip(colours, dict.fromkeys(row["vertices"] for row in mine)):
                one = [row for row in mine if row["vertices"] == count]
                points = [(row["substeps"], row[key]) for row in one if row[key] is not None and row[key] > 0.0]
                axes.plot(*zip(*points), "o-", color=colour, ms=3.5, lw=1.4, label=f"{count} vertices")
                if key == "artificial_mm":
                    law = [(row["substeps"], row["artificial_law_mm"]) for row in one]
                    axes.plot(*zip(*law), "--", color=colour, lw=0.9)
            axes.set_xscale("log", base=2)
            axes.set_xticks(substeps := sorted({int(row["substeps"]) for row in mine}), [str(n) for n in substeps])
            axes.set_yscale("log")
            axes.set_xlabel("substeps a frame")
            axes.set_title(f"{scene}: {label}", fontsize=9, loc="left")
            axes.grid(alpha=0.25)
            if column == 0:
                axes.legend(fontsize=7.5, frameon=False)
    return figure


def main(given: Sequence[str] | None = None) -> None:
    """Run both scenes over substeps and meshes; print, write the table and the plot."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.convergence", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), help="folder of the table and the plot")
    parser.add_argument("--substeps", type=int, nargs="+", default=list(SUBSTEPS), help="substeps a frame, at least 2")
    parser.add_argument("--rows", type=int, nargs="*", default=list(SHEET_ROWS), help="rows of the hanging sheets")
    parser.add_argument("--skirt", type=int, nargs="*", default=list(SKIRT_VERTICES), help="vertices of the skirts")
    parser.add_argument("--frames", type=int, default=30, help="recorded frames of the skirt")
    options = parser.parse_args(given)
    substeps = sorted(set(options.substeps))
    if len(substeps) < 2 or substeps[0] < 1 or not options.rows + options.skirt:
        parser.error("two different numbers of substeps from 1 on, and a sheet or a skirt, are needed")
    compile_kernels("cpu")
    body = Body.load("full")
    scenes = [hanging_sheet(rows, body) for rows in sorted(options.rows)]
    scenes += [walking_skirt(count, body, options.frames) for count in sorted(options.skirt)]
    groups = []
    for number, scene in enumerate(scenes, start=1):
        print(
            f"[convergence] {number}/{len(scenes)}: {scene.name}, {len(scene.template.vertices)} vertices", flush=True
        )
        groups.append(simulate(scene, substeps))
    rows = report_rows(groups)
    options.out.mkdir(parents=True, exist_ok=True)
    write_table(options.out / "convergence.csv", rows)
    convergence_figure(rows).savefig(options.out / "convergence.png", dpi=130)
    print(printed(rows))
    for runs in groups:
        order = order_of_convergence(runs[:-2], extrapolated(runs)) if len(runs) > 3 else float("nan")
        print(f"{runs[0].scene.name}, {len(runs[0].scene.template.vertices)} vertices: surplus falls as dt^{order:.2f}")


if __name__ == "__main__":
    main()

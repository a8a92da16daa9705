"""Milliseconds of one core a frame, from a label to a dressed body, at the papers' sizes.

``python -m benchmarks.runtime`` prints a table: a motion of 60 frames drawn from a label (Shi 2023), its body of 6,890
vertices, a garment of 3,326 vertices on it, and their sum; the decoding of a garment from the intrinsic space (Wang
2019); and the refinement of 5,787 vertices that are inside the body here and there. One sequence at a time. Beside the
sums stands what they may take.

What a network costs does not depend on what it has learned: here they have their published sizes, or those of this
project's variants, and random weights. Figures are processor time, medians over repetitions.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.measure import pin_to_one_core
from body.model import Body, skin
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from geometry.rotations import axis_angle_to_6d
from geometry.topology import vertex_normals
from models.dense_motion_cvae import DenseMotionConfig, DenseMotionCVAE
from models.garment_fitting import build_regressor
from models.garment_regressor import variant_config
from models.intrinsic_fitting import build_motion_invariant, decode_frames
from models.motion_cvae import MotionCVAE, MotionCVAEConfig
from models.motion_features import MotionTrack
from models.motion_generator import MotionGenerator
from models.motion_invariant import MotionInvariantConfig
from models.refinement import RefinementSettings, Refiner
from models.shape_descriptor import PaperDescriptor, ShapeDescriptorConfig, decode_all
from motions.clip import Clip
from motions.procedural import generate_clip
from pipeline.motion_data import generated_tracks

FRAMES, FPS, LEAD_IN, SEED = 60, 30.0, 24, 20191
LABELS = tuple(f"label {number}" for number in range(66))  # as many as the paper has
REGRESSORS = ("paper", "steady", "window")
DEFAULT_SIZES = {"window": {"components": 256, "centres": 6600}}  # of the default run, where other than the code has

GOALS = {
    "label to dressed body": 2.3,
    "the same, feet planted": 2.3,
    "decode from the intrinsic space": 6.0,
    "refinement": 12.0,
    "refinement, with edges": 12.0,
}
"""Most milliseconds a frame, at the default sizes."""

Row = dict[str, str | int | float]


def milliseconds(road: Callable[[], object], frames: int, repetitions: int) -> dict[str, float]:
    """Median and 95th percentile of the processor time a frame [ms]; the first run warms up."""
    times = []
    for _ in range(repetitions + 1):
        start = time.process_time()
        road()
        times.append(1e3 * (time.process_time() - start) / frames)
    return {"median_ms": float(np.median(times[1:])), "p95_ms": float(np.quantile(times[1:], 0.95))}


def motion_models(clip: Clip) -> dict[str, MotionGenerator]:
    """The paper's motion CVAE and ours, which draws near the motions that it was trained on: here, one a label."""
    dense = DenseMotionCVAE(DenseMotionConfig(LABELS, clip.frames, len(LABELS)))
    poses = torch.as_tensor(axis_angle_to_6d(clip.pose).astype(np.float32)).repeat(len(LABELS), 1, 1, 1)
    dense.finish(poses, torch.arange(len(LABELS)))
    return {"paper": MotionCVAE(MotionCVAEConfig(LABELS)).eval(), "dense": dense.eval()}


class Recorded:
    """In place of a motion CVAE: what a random network draws is no motion that a body could do."""

    def __init__(self, clip: Clip, travels: bool) -> None:
        self.pose6d = axis_angle_to_6d(clip.pose).astype(np.float32)[None]
        self.root = clip.root[None] if travels else None

    def sample_motions(
        self, labels: Sequence[str], frames: int, generator: torch.Generator
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The clip's poses [1, T, 24, 6] and, of a generator that travels, its root [1, T, 3] [m]."""
        return self.pose6d, self.root


def animation_rows(body: Body, template: GarmentTemplate, clip: Clip, repetitions: int) -> list[Row]:
    """From a label to a dressed body: the parts, and the sums for the paper's networks and for ours."""
    rows: list[Row] = []

    def timed(part: str, model: str, vertices: int, road: Callable[[], object]) -> float:
        rows.append({"part": part, "model": model, "vertices": vertices} | milliseconds(road, clip.frames, repetitions))
        return rows[-1]["median_ms"]

    drawn, planted, dressed = {}, {}, {}
    for name, model in motion_models(clip).items():
        generator = torch.Generator().manual_seed(SEED)
        drawn[name] = timed("draw poses", name, 0, lambda m=model, g=generator: m.sample([LABELS[0]], clip.frames, g))
        arguments = (Recorded(clip, model.travels), [LABELS[0]], clip.frames, FPS, LEAD_IN, body, torch.Generator())
        planted[name] = timed("root, feet planted, lead-in", name, 0, lambda a=arguments: generated_tracks(*a))
    posed = timed("body", "-", len(body.vertices), lambda: body.posed(clip.pose, clip.root))
    track = MotionTrack(clip.pose, body.joint_positions(clip.pose, clip.root), 0, FPS)
    for name in REGRESSORS:
        config = variant_config(name, len(template.vertices), **DEFAULT_SIZES.get(name, {}))
        regressor = build_regressor(config, template.faces).eval()
        dressed[name] = timed("garment", name, len(template.vertices), lambda r=regressor: r.dress(track))
    for name, motion, garment in (("paper", "paper", "paper"), ("ours", "dense", "window")):
        total = drawn[motion] + posed + dressed[garment]
        for part, extra in (("label to dressed body", 0.0), ("the same, feet planted", planted[motion])):
            row = {"part": part, "model": name, "vertices": len(template.vertices), "median_ms": total + extra}
            rows.append(row)
    return rows


def intrinsic_row(template: GarmentTemplate, repetitions: int) -> Row:
    """From z and a motion signature to a shape, both networks of the paper's size, 60 frames at once."""
    descriptor = PaperDescriptor(ShapeDescriptorConfig(), template.faces, len(template.vertices)).eval()
    network = build_motion_invariant(MotionInvariantConfig(), descriptor.config.code, 1200, 0).eval()
    z = np.zeros((FRAMES, network.config.latent), dtype=np.float32)
    signatures = np.zeros((FRAMES, 1200), dtype=np.float32)
    taken = milliseconds(lambda: decode_all(descriptor, decode_frames(network, z, signatures)), FRAMES, repetitions)
    return {"part": "decode from the intrinsic space", "model": "paper", "vertices": len(template.vertices)} | taken


def refinement_row(
    body: Body, template: GarmentTemplate, clip: Clip, repetitions: int, settings: RefinementSettings | None = None
) -> Row:
    """Refinement of a garment that is 6 mm too tight and follows the skeleton alone: the body comes through it.

    A garment's first sequence takes longer: what the solver keeps of each vertex that is pushed is computed then.
    """
    transforms = body.joint_transforms(clip.pose, clip.root)
    tight = template.vertices - 0.006 * vertex_normals(template.vertices, template.faces)
    cloth = skin(tight, template.skin_index, template.skin_weight, transforms).astype(np.float32)
    surface = body.posed(clip.pose, clip.root)
    refiner = Refiner(template.topology, body.faces, len(body.vertices), settings)
    start = time.process_time()
    inside = refiner.refine_sequence(cloth, surface)[1].inside / clip.frames
    first = 1e3 * (time.process_time() - start) / clip.frames
    taken = milliseconds(lambda: refiner.refine_sequence(cloth, surface), clip.frames, repetitions) | {
        "first_ms": first
    }
    part = "refinement, with edges" if settings and settings.edges else "refinement"
    return {"part": part, "model": f"{inside:.0f} inside", "vertices": len(template.vertices)} | taken


def main() -> None:
    """Print the table; write it where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=3326, help="of the garment")
    parser.add_argument("--refined", type=int, default=5787, help="vertices of the garment that is refined")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--json", type=Path, help="write the table here as well")
    options = parser.parse_args()
    pin_to_one_core()
    torch.set_num_threads(1)
    torch.manual_seed(SEED)
    body = Body.load("full")
    clip = generate_clip("walk", 0, FRAMES, FPS, SEED, body)
    template = build_template(GarmentSpec("skirt", "skirt", options.vertices), body)
    rows = animation_rows(body, template, clip, options.repetitions)
    rows.append(intrinsic_row(template, options.repetitions))
    fine = build_template(GarmentSpec("skirt", "skirt", options.refined), body)
    for settings in (RefinementSettings(), RefinementSettings(edges=True)):
        rows.append(refinement_row(body, fine, clip, options.repetitions, settings))
    for row in rows:
        p95 = f"{row['p95_ms']:8.2f}" if "p95_ms" in row else 8 * " "
        goal = f"   at most {GOALS[row['part']]:.1f}" if row["part"] in GOALS else ""
        goal += f"   first sequence {row['first_ms']:.2f}" if "first_ms" in row else ""
        print(f"{row['part']:34s}{row['model']:12s}{row['vertices']:6d} vertices{row['median_ms']:8.2f}{p95}{goal}")
    print("milliseconds of one core a frame: median and 95th percentile of repetitions; one sequence of 60 frames")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

"""Stage ``evaluate_shape_descriptor``: how well a short code keeps a garment (Wang 2019, Fig. 6 to 9).

In: the template, the folder of the curve, all variants of the descriptor and all shards of a garment. Out: the
garment's rows of three tables. ``shape_descriptor``: every variant and the curve beside principal components, fitted to
the same frames, for each held-out split. ``descriptor_interpolation``: strain between two frames.
``descriptor_projection``: implausible shapes before and after.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.sequences import Sequence
from datasets.splits import SPLITS, TRAIN
from evaluation.descriptor import descriptor_rows
from evaluation.descriptor_shapes import interpolation_rows, projection_rows
from evaluation.seeds import average_seeds
from evaluation.table import Row, merge_tables, write_table
from garments.template import GarmentTemplate
from models.pca import fit_pca
from models.shape_descriptor import ShapeDescriptor, load_shape_descriptor
from pipeline.sequence_data import canonical_frames, frame_numbers, job_body, job_sequences
from pipeline.stage import Job, run_stage

SHAPES = 60
"""Frames, or pairs of frames, of the tables of shapes that no frame has."""
MOST_NEAREST = 4000
"""Training frames that implausible shapes are judged by: the nearest of them, their components, their codes."""


def main(job: Job) -> None:
    """Load, evaluate, write."""
    spec, evaluation = job.spec, job.spec["evaluation"]
    count = len(spec["variants"])
    template = GarmentTemplate.load(job.inputs[0])
    variants = [load_shape_descriptor(path, template.faces) for path in job.inputs[2 : 2 + count]]
    curve = curve_modules(job.inputs[1], template.faces)
    sequences, body = job_sequences(job, job.inputs[2 + count :]), job_body(job)
    chosen = {split: [s for s in sequences if s.split == split] for split in SPLITS}
    training = canonical_frames(chosen.pop(TRAIN), body)
    held_out = {split: found for split, found in chosen.items() if found}
    if not held_out:
        raise ValueError(f"{spec['garment']}: no held-out sequence was simulated, there is nothing to evaluate on")
    stride = evaluation["frames_stride"]
    tests = {split: canonical_frames(found, body)[::stride] for split, found in held_out.items()}
    clips = {split: clip_numbers(found)[::stride] for split, found in held_out.items()}
    modules = [*variants, *curve]
    dimensions, seed = evaluation["pca_dimensions"], spec["seed"]
    rows = descriptor_rows(modules, training, tests, dimensions, seed, clips)
    _write(job, 0, average_seeds(rows, ["rmse_mm"]))

    # Figures 8 and 9 at the length in use, with and without the Laplacian term.
    used = variants[spec["variants"].index(spec["use"])]
    shown = [m for m in modules if m.config.code == used.config.code]
    split, frames, other = held_out_pairs(tests, clips, seed)
    rest, edges = template.vertices, template.topology.edges
    between = interpolation_rows(shown, frames, other, rest, edges)
    _write(job, 1, merge_tables([between], split=split))
    nearest = training[:: -(-len(training) // MOST_NEAREST)]
    most = min(len(nearest) - 1, 3 * nearest.shape[1])
    pca = fit_pca(nearest.reshape(len(nearest), -1), used.config.code, seed) if used.config.code <= most else None
    projected = projection_rows(shown, pca, nearest, frames, rest, edges, seed)
    _write(job, 2, merge_tables([projected], split=split))


def curve_modules(folder: str | Path, faces: np.ndarray) -> list[ShapeDescriptor]:
    """The descriptors of the curve, shortest code first, and the one without the Laplacian term after its equals."""
    found = [load_shape_descriptor(path, faces) for path in sorted(Path(folder).glob("*.pt"))]
    return sorted(found, key=lambda m: (m.config.code, -m.config.laplacian_weight))


def clip_numbers(sequences: list[Sequence]) -> np.ndarray:
    """Number of the clip of each frame, shape [N]."""
    names = {name: number for number, name in enumerate(sorted({s.clip for s in sequences}))}
    return frame_numbers(sequences, (names[s.clip] for s in sequences))


def held_out_pairs(
    tests: dict[str, np.ndarray], clips: dict[str, np.ndarray], seed: int
) -> tuple[str, np.ndarray, np.ndarray]:
    """Pairs of frames [P, V, 3] of the split with the most clips, of two clips where it has two."""
    split = max(tests, key=lambda name: len(np.unique(clips[name])))
    frames, of = tests[split], clips[split]
    generator = np.random.default_rng(seed)
    first = generator.choice(len(frames), min(SHAPES, len(frames)), replace=False)
    second = np.empty_like(first)
    for k, frame in enumerate(first):
        others = np.flatnonzero(of != of[frame])
        second[k] = generator.choice(others if len(others) else len(frames))
    return split, frames[first], frames[second]


def _write(job: Job, output: int, rows: list[Row]) -> None:
    write_table(job.outputs[output], merge_tables([rows], garment=job.spec["garment"]))


if __name__ == "__main__":
    run_stage(main)

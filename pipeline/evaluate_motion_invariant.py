"""Stage ``evaluate_motion_invariant``: does z hold the material and not the motion? (Wang 2019, Figs. 10 and 11)

In: the descriptor in use, the codes that it made, all variants of the autoencoder and all shards of a garment. Out: the
garment's rows of the tables ``motion_invariant`` (own reconstruction, transfer to other motions of the same parameters
against the simulated truth, controls, variance ratio of z) and ``parameter_recovery`` (R^2 from z to each intrinsic
parameter, and how much that parameter shapes the garment).
"""

from __future__ import annotations

import numpy as np

from datasets.codes import CodedSequence
from datasets.sequences import to_canonical
from datasets.shards import MATERIALS
from datasets.splits import TRAIN, UNSEEN_BOTH, UNSEEN_MOTIONS, UNSEEN_PARAMETERS
from evaluation.intrinsic import ReadFrames, against_controls, transfer_rows, variance_row
from evaluation.recovery import effects_mm, recovery_rows
from evaluation.seeds import average_seeds
from evaluation.table import Row, merge_tables, write_table
from models.intrinsic_fitting import load_motion_invariant
from models.motion_invariant import MotionInvariantNetwork
from models.parameter_groups import GROUPS, with_groups
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, load_shape_descriptor
from pipeline.intrinsic_data import (
    LOGARITHMIC,
    all_codes,
    check_same_frames,
    intrinsic_frames,
    job_codes,
    varied_parameters,
)
from pipeline.sequence_data import frame_numbers, job_body, job_sequences
from pipeline.stage import Job, run_stage

# z may come from any clip that was simulated with the parameter set: seen clips too, where the motion is unseen.
SOURCES = {
    UNSEEN_PARAMETERS: (UNSEEN_PARAMETERS,),
    UNSEEN_MOTIONS: (TRAIN,),
    UNSEEN_BOTH: (UNSEEN_PARAMETERS,),
}


def main(job: Job) -> None:
    """Load, evaluate every variant on every held-out split, write."""
    spec, names = job.spec, list(job.spec["variants"])
    descriptor = load_shape_descriptor(job.inputs[0])
    networks = [load_motion_invariant(path) for path in job.inputs[2 : 2 + len(names)]]
    body = job_body(job)
    splits = (TRAIN, *SOURCES)
    sequences = job_codes(job, job.inputs[1], job.inputs[0], splits, (MATERIALS,))
    codes = all_codes(sequences)
    held_out = job_sequences(job, job.inputs[2 + len(names) :], tuple(SOURCES), (MATERIALS,))
    check_same_frames([s for s in sequences if s.split != TRAIN], held_out)
    owner = frame_numbers(sequences, (splits.index(s.split) for s in sequences))
    of_split = {split: np.flatnonzero(owner == number) for number, split in enumerate(splits)}
    truth = {
        split: np.concatenate([to_canonical(s.vertices, s.pose, s.root, body) for s in held_out if s.split == split])
        for split in SOURCES
        if len(of_split[split])
    }
    varied = varied_parameters(sequences)
    parameters = {s.phi: {name: with_groups(s.parameters)[name] for name in varied} for s in sequences}
    transfer, recovery, effects = [], [], {}
    for name, network in zip(names, networks, strict=True):
        # All splits at once, so that a clip has the same number in each of them.
        frames = intrinsic_frames(sequences, codes, network.config, varied)
        read = ReadFrames.of(network, frames)
        training = read.at(of_split[TRAIN])
        labels: Row = {"variant": name, "window": network.config.window}
        for split, vertices in truth.items():
            test = read.at(of_split[split])
            pool = read.at(np.concatenate([of_split[other] for other in SOURCES[split]]))
            stride = spec["evaluation"]["frames_stride"]
            rows = transfer_rows(descriptor, test, vertices, training, split, pool, spec["seed"], stride=stride)
            ratio = variance_row(test, split)
            ratios = {"variance_ratio": ratio["ratio"], "clip_variance_ratio": ratio["clip_ratio"]}
            transfer += [labels | row | ratios for row in rows]
        tests = {split: read.at(of_split[split]) for split in (UNSEEN_PARAMETERS, UNSEEN_BOTH) if split in truth}
        if network.config.variant == "true-parameters":
            effects = _effects(descriptor, network, training.frames, sequences, varied)
        elif network.config.variant != "motion-only":
            recovery += merge_tables([recovery_rows(training, tests, parameters, LOGARITHMIC)], **labels)
    recovery = [row | {"effect_mm": effects.get(row["parameter"])} for row in recovery]
    transfer = average_seeds(against_controls(transfer), ["rmse_mm", "clip_variance_ratio"])
    write_table(job.outputs[0], merge_tables([transfer], garment=spec["garment"]))
    write_table(job.outputs[1], merge_tables([average_seeds(recovery, ["r2"])], garment=spec["garment"]))


def _effects(
    descriptor: ShapeDescriptor,
    network: MotionInvariantNetwork,
    frames: IntrinsicFrames,
    sequences: list[CodedSequence],
    varied: tuple[str, ...],
) -> dict[str, float]:
    sets = {s.phi: s.parameters for s in sequences if s.split == TRAIN}
    middle, spreads = {}, {}
    for name in sequences[0].parameters:
        values = np.array([p[name] for p in sets.values()])
        scaled = np.log(values) if name in LOGARITHMIC else values
        middle[name] = float(np.exp(scaled.mean()) if name in LOGARITHMIC else scaled.mean())
        if name in varied and name not in GROUPS:
            spreads[name] = float(scaled.std())
    return effects_mm(descriptor, network, frames, varied, LOGARITHMIC, middle, spreads)


if __name__ == "__main__":
    run_stage(main)

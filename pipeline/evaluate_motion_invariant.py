"""Stage ``evaluate_motion_invariant``: does z hold the material and not the motion? (Wang 2019, Figs. 10 and 11)

In: the descriptor in use, all variants of the autoencoder and all shards of a garment. Out: the garment's rows of the
tables ``motion_invariant`` (own reconstruction, transfer to other motions of the same parameters against the simulated
truth, controls, variance ratio of z) and ``parameter_recovery`` (R^2 from z to each intrinsic parameter).
"""

from __future__ import annotations

import numpy as np

from datasets.shards import MATERIALS
from datasets.splits import SPLITS, TRAIN, UNSEEN_BOTH, UNSEEN_MOTIONS, UNSEEN_PARAMETERS
from evaluation.intrinsic import recovery_rows, transfer_rows, variance_row
from evaluation.table import merge_tables, write_table
from models.motion_invariant import load_motion_invariant
from models.shape_descriptor import load_shape_descriptor
from pipeline.intrinsic_data import intrinsic_frames
from pipeline.sequence_data import canonical_frames, frame_numbers, job_body, job_sequences
from pipeline.stage import Job, run_stage
from sim.parameters import INTRINSIC_PARAMETERS


def main(job: Job) -> None:
    """Load, evaluate every variant on every held-out split, write."""
    spec, count = job.spec, len(job.spec["variants"])
    descriptor = load_shape_descriptor(job.inputs[0])
    networks = [load_motion_invariant(path) for path in job.inputs[1 : 1 + count]]
    body = job_body(job)
    sequences = job_sequences(job, job.inputs[1 + count :], plans=(MATERIALS,))
    vertices = canonical_frames(sequences, body)
    # All splits at once, so that a clip has the same number in each of them.
    frames = intrinsic_frames(sequences, descriptor, spec["window"], body)
    owner = frame_numbers(sequences, (SPLITS.index(s.split) for s in sequences))
    of_split = {split: np.flatnonzero(owner == number) for number, split in enumerate(SPLITS)}
    training = frames.at(of_split[TRAIN])
    # z may come from any clip that was simulated with the parameter set: seen clips too, where the motion is unseen.
    sources = {
        UNSEEN_PARAMETERS: (UNSEEN_PARAMETERS,),
        UNSEEN_MOTIONS: (TRAIN,),
        UNSEEN_BOTH: (UNSEEN_PARAMETERS,),
    }
    parameters = {s.phi: s.parameters for s in sequences}
    logarithmic = {p.name for p in INTRINSIC_PARAMETERS if p.logarithmic}
    transfer, recovery = [], []
    for network in networks:
        for split, allowed in sources.items():
            index = of_split[split]
            if not len(index):
                continue
            pool = frames.at(np.concatenate([of_split[name] for name in allowed]))
            test = frames.at(index)
            rows = transfer_rows(descriptor, network, test, vertices[index], training, split, pool, spec["seed"])
            ratio = variance_row(network, test, split)
            ratios = {"variance_ratio": ratio["ratio"], "clip_variance_ratio": ratio["clip_ratio"]}
            transfer += [row | ratios for row in rows]
        tests = {split: frames.at(of_split[split]) for split in (UNSEEN_PARAMETERS, UNSEEN_BOTH)}
        recovery += recovery_rows(network, training, tests, parameters, logarithmic)
    write_table(job.outputs[0], merge_tables([transfer], garment=spec["garment"]))
    write_table(job.outputs[1], merge_tables([recovery], garment=spec["garment"]))


if __name__ == "__main__":
    run_stage(main)

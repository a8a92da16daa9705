"""Stage ``evaluate_shape_descriptor``: how well a short code keeps a garment (Wang 2019, Fig. 7).

In: all variants of the descriptor and all shards of a garment. Out: the garment's rows of the table
``shape_descriptor``: every variant beside principal components, fitted to the same frames, for each held-out split.
"""

from __future__ import annotations

from datasets.splits import SPLITS, TRAIN
from evaluation.descriptor import descriptor_rows
from evaluation.table import merge_tables, write_table
from models.shape_descriptor import load_shape_descriptor
from pipeline.sequence_data import canonical_frames, job_body, job_sequences
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Load, evaluate, write."""
    spec, evaluation = job.spec, job.spec["evaluation"]
    count = len(spec["variants"])
    modules = [load_shape_descriptor(path) for path in job.inputs[:count]]
    sequences, body = job_sequences(job, job.inputs[count:]), job_body(job)
    chosen = {split: [s for s in sequences if s.split == split] for split in SPLITS}
    training = canonical_frames(chosen.pop(TRAIN), body)
    tests = {split: canonical_frames(s, body)[:: evaluation["frames_stride"]] for split, s in chosen.items() if s}
    rows = descriptor_rows(modules, training, tests, evaluation["pca_dimensions"], spec["seed"])
    write_table(job.outputs[0], merge_tables([rows], garment=spec["garment"]))


if __name__ == "__main__":
    run_stage(main)

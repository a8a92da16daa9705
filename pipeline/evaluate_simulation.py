"""Stage ``evaluate_simulation``: what was simulated, how good it is, and what was dropped and why.

In: all shards of a garment. Out: the garment's rows of the tables ``simulation`` and ``dropped``.
"""

from __future__ import annotations

from datasets.shards import read_dropped, read_header, read_quality
from evaluation.simulation import simulation_rows
from evaluation.table import write_table
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Read the quality figures of every shard and summarise them."""
    kept, dropped = [], []
    for path in job.inputs:
        header = read_header(path)
        where = {"garment": header.garment, "plan": header.plan}
        kept += [where | row for row in read_quality(path)]
        dropped += [where | vars(record) for record in read_dropped(path)]
    write_table(job.outputs[0], simulation_rows(kept, dropped))
    # A table is never empty: a garment without losses says so.
    none = {"garment": job.spec["garment"], "plan": "", "clip": "none was dropped", "reason": ""}
    write_table(job.outputs[1], dropped or [none])


if __name__ == "__main__":
    run_stage(main)

"""Stage ``table``: the parts of a table, one a garment, laid under each other.

In: CSV files. Out: one CSV file with all columns that any part has.
"""

from __future__ import annotations

from evaluation.table import read_table, write_table
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Read, join, write."""
    write_table(job.outputs[0], [row for path in job.inputs for row in read_table(path)])


if __name__ == "__main__":
    run_stage(main)

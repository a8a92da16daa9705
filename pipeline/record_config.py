"""Stage ``record_config``: the configuration of a run, kept beside its results for those who use its models.

Out: ``config.json``, from which ``runtime.finished_run`` knows what the run's folder holds.
"""

from __future__ import annotations

import json

from datasets.atomic import write_text
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Write the configuration as it was merged and checked."""
    write_text(job.outputs[0], json.dumps(job.spec, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    run_stage(main)

"""Stage ``report``: the page of the run.

In: the folder of the run. Out: ``report.html``, one file that holds its pictures, charts, style and script.
"""

from __future__ import annotations

from datasets.atomic import write_text
from pipeline.plan import plan_clips
from pipeline.stage import Job, run_stage
from report.page import build_page


def main(job: Job) -> None:
    """Gather, lay out, write."""
    clips = plan_clips(job.spec["motions"])
    plan = {"clips": len(clips), "labels": len({clip.label for clip in clips})}
    write_text(job.outputs[0], build_page(job.inputs[0], job.spec, plan))


if __name__ == "__main__":
    run_stage(main)

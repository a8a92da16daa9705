"""Stage ``motions``: one batch of labelled clips, generated or cut from recordings.

In: the planned clips and their source. Out: an HDF5 file of clips.
"""

from __future__ import annotations

from body.model import Body
from motions.clip_file import write_clips
from pipeline.progress import Progress
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Make every clip of the batch and write them."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    make = _procedural if spec["source"] == "procedural" else _recorded
    write_clips(job.outputs[0], make(spec, body))


def _procedural(spec: dict, body: Body) -> list:
    from motions.procedural import generate_clip

    progress = Progress("motions", len(spec["clips"]), "clips")
    clips = []
    for planned in spec["clips"]:
        clips.append(generate_clip(planned["label"], planned["part"], spec["frames"], spec["fps"], spec["seed"], body))
        progress()
    progress.finish()
    return clips


if __name__ == "__main__":
    run_stage(main)

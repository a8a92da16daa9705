"""Stage ``motions``: one batch of labelled clips, generated or cut from recordings.

In: the planned clips and their source. Out: an HDF5 file of clips.
"""

from __future__ import annotations

from body.model import Body
from motions.bvh_folder import list_takes
from motions.clip import Clip
from motions.clip_file import write_clips
from motions.procedural import generate_clip
from pipeline.progress import Progress
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Make every clip of the batch and write them."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    make = _procedural if spec["source"] == "procedural" else _recorded
    write_clips(job.outputs[0], make(spec, body))


def _procedural(spec: dict, body: Body) -> list[Clip]:
    progress = Progress("motions", len(spec["clips"]), "clips")
    clips = []
    for planned in spec["clips"]:
        clips.append(generate_clip(planned["label"], planned["part"], spec["frames"], spec["fps"], spec["seed"], body))
        progress()
    progress.finish()
    return clips


def _recorded(spec: dict, body: Body) -> list[Clip]:
    wanted = {planned["name"]: planned for planned in spec["clips"]}
    takes = {take.file: take for take in list_takes(spec["folder"], spec["labels_file"])}
    progress = Progress("motions", len(wanted), "clips")
    made = {}
    for file in dict.fromkeys(planned["take"] for planned in spec["clips"]):
        for clip in takes[file].clips(spec["frames"], spec["fps"], body):
            if clip.name in wanted:
                made[clip.name] = clip
                progress()
    progress.finish()
    return [made[name] for name in wanted]


if __name__ == "__main__":
    run_stage(main)

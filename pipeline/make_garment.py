"""Stage ``garment``: build one garment's template on the body in its bind pose.

In: the body and the garment's geometry. Out: a template ``.npz``.
"""

from __future__ import annotations

from body.model import Body
from garments.build import build_template
from garments.spec import GarmentSpec
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Build and save the template."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    template = build_template(GarmentSpec(name=spec["garment"], **spec["geometry"]), body)
    template.save(job.outputs[0])
    print(f"[garment {spec['garment']}] {len(template.vertices)} vertices, {len(template.faces)} triangles")


if __name__ == "__main__":
    run_stage(main)

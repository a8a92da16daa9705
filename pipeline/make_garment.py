"""Stage ``garment``: make one garment's template on the body in its bind pose.

In: the body and the garment's geometry; for garments of kind mesh, the user's mesh files. Out: a template ``.npz``.
"""

from __future__ import annotations

from body.model import Body
from garments.outfit import garment_spec, make_template
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Build or import the template and save it."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    template = make_template(garment_spec(spec["garment"], spec["geometry"]), body)
    template.save(job.outputs[0])
    print(f"[garment {spec['garment']}] {len(template.vertices)} vertices, {len(template.faces)} triangles")


if __name__ == "__main__":
    run_stage(main)

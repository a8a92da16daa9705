"""Stage ``garment``: make one garment's template on the body in its bind pose.

In: the body and the garment's geometry; for a garment of kind mesh, the user's mesh file. Out: a template ``.npz``.
"""

from __future__ import annotations

from body.model import Body
from garments.build import build_template
from garments.import_mesh import import_garment
from garments.spec import GarmentSpec, MeshGarmentSpec
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Build or import the template and save it."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    geometry = dict(spec["geometry"])
    if geometry["kind"] == "mesh":
        del geometry["kind"]
        template = import_garment(MeshGarmentSpec(spec["garment"], **geometry), body)
    else:
        template = build_template(GarmentSpec(name=spec["garment"], **geometry), body)
    template.save(job.outputs[0])
    print(f"[garment {spec['garment']}] {len(template.vertices)} vertices, {len(template.faces)} triangles")


if __name__ == "__main__":
    run_stage(main)

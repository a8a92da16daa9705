"""Stage ``simulate_wardrobe``: one garment of the wardrobe, built and simulated.

In: motion batches, and in the spec the garment's geometry and its (parameter set, clip) pairs. Out: the template
``.npz`` and its shard, as of stage ``simulate``, which does the simulating.
"""

from __future__ import annotations

from body.model import Body
from garments.build import build_template
from garments.spec import VERTEX_LIMITS, GarmentSpec
from garments.template import GarmentTemplate
from pipeline import simulate
from pipeline.stage import Job, run_stage

ATTEMPTS = 4
MORE_VERTICES = 1.03
"""Meshes tried of a sampled garment, each with that many times the vertices of the one before."""


def main(job: Job) -> None:
    """Build the template, save it, and simulate it on its clips."""
    spec = job.spec
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    template = sampled_template(spec["garment"], spec["geometry"], body)
    template_path, shard_path = job.outputs
    template.save(template_path)
    print(f"[wardrobe {template.name}] {len(template.vertices)} vertices, {len(template.faces)} triangles", flush=True)
    simulate.main(Job(spec, [template_path, *job.inputs], [shard_path], job.device, job.threads))


def sampled_template(name: str, geometry: dict, body: Body) -> GarmentTemplate:
    """Build a garment whose measures nobody chose; a mesh that misses a bound is made with a few more vertices.

    Raises:
        ValueError: The measures do not fit this body, or no attempt was within the bounds; of the last one.
    """
    count = geometry["vertices"]
    for attempt in range(ATTEMPTS):
        wanted = min(round(count * MORE_VERTICES**attempt), VERTEX_LIMITS[geometry["kind"]][1])
        try:
            return build_template(GarmentSpec(name, **geometry | {"vertices": wanted}), body)
        except ValueError as error:
            if "more vertices" not in str(error) or attempt == ATTEMPTS - 1:
                raise
            print(f"[wardrobe {name}] tried again: {error}", flush=True)
    raise AssertionError("the last attempt returns or raises")


if __name__ == "__main__":
    run_stage(main)

"""Stage ``simulate_wardrobe``: one garment of the wardrobe, built and simulated.

In: motion batches, and in the spec the garment's geometry and its (parameter set, clip) pairs. Out: the template
``.npz`` and its shard, as of stage ``simulate``, which does the simulating.
"""

from __future__ import annotations

from body.model import Body
from garments.build import build_template
from garments.spec import MEASURES, VERTEX_LIMITS, GarmentSpec
from garments.template import GarmentTemplate
from pipeline import simulate
from pipeline.stage import Job, run_stage

ATTEMPTS = 6
MORE_VERTICES, LESS_EASE = 1.03, 0.8
"""Meshes tried of a sampled garment; each has so many times the vertices, or the ease, of the one before."""


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
    """Build a garment whose measures nobody chose.

    A mesh that misses a bound is made with a few more vertices, one whose openings run into each other with less ease.

    Raises:
        ValueError: The measures do not fit this body, or no attempt was within the bounds; of the last one.
    """
    tried = dict(geometry)
    for attempt in range(ATTEMPTS):
        try:
            return build_template(GarmentSpec(name, **tried), body)
        except ValueError as error:
            said = str(error)
            if attempt == ATTEMPTS - 1:
                raise
        if "more vertices" in said:
            tried["vertices"] = min(round(tried["vertices"] * MORE_VERTICES), VERTEX_LIMITS[tried["kind"]][1])
        elif "lower ease" in said:
            tried["ease"] = max(round(tried["ease"] * LESS_EASE, 4), MEASURES[tried["kind"]]["ease"].low)
        else:
            raise ValueError(said)
        print(f"[wardrobe {name}] tried again: {said}", flush=True)
    raise AssertionError("the last attempt returns or raises")


if __name__ == "__main__":
    run_stage(main)

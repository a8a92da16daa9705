"""Stage ``mesh_hierarchy``: the body mesh at several resolutions, over the vertices that any type of clothing covers.

In: the templates of all types. Out: an ``.npz`` file with the levels and the matrices between them.
"""

from __future__ import annotations

import numpy as np

from garments.body_layer import cast_layer
from garments.template import GarmentTemplate
from geometry.mesh_hierarchy import build_hierarchy
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Collapse and save."""
    body = job_body(job)
    covered = [cast_layer(GarmentTemplate.load(path), body).covered for path in job.inputs]
    active = np.unique(np.concatenate(covered))
    counts = [len(active) >> k for k in range(1, job.spec["levels"])]
    hierarchy = build_hierarchy(body.vertices, body.faces, active, counts, body.digest)
    hierarchy.save(job.outputs[0])
    print(f"[mesh_hierarchy] levels of {', '.join(str(len(level)) for level in hierarchy.levels)} vertices")


if __name__ == "__main__":
    run_stage(main)

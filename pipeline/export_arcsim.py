"""Stage ``export_arcsim``: the clip that the solvers are timed on, as a scene for ARCSim.

In: the template and a batch of motions. Out: ``scene.json`` in a folder with meshes and material beside it;
``mapping.json`` says what is not the same there. It is run by ``arcsim simulateoffline scene.json out``, started
in that folder.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from garments.template import GarmentTemplate
from motions.clip_file import read_clips
from motions.lead_in import lead_in
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from sim.arcsim.scene import ArcsimSettings, write_scene
from sim.parameters import base_parameters


def main(job: Job) -> None:
    """Write the scene."""
    spec = job.spec
    body, template = job_body(job), GarmentTemplate.load(job.inputs[0])
    clip = read_clips(job.inputs[1])[0]
    lead_pose, lead_root = lead_in(clip, body, spec["lead_in"])
    settings = ArcsimSettings(
        spec["fps"], spec["timing"]["implicit"]["steps_per_frame"], spec["settle"], strain_limits=(0.95, 1.05)
    )
    scene = write_scene(
        Path(job.outputs[0]).parent,
        template,
        body,
        np.concatenate([lead_pose, clip.pose]),
        np.concatenate([lead_root, clip.root]),
        spec["lead_in"],
        base_parameters(spec["base"]),
        settings,
    )
    laid, segments = scene.mapping["flattening"], scene.mapping["segments"]
    print(
        f"[export_arcsim] {spec['garment']} in {laid['panels']:.0f} panels, laid flat within "
        f"{laid['largest_strain']:.1%}; segments up to {1e3 * segments['off_skin_max_m']:.0f} mm off the skin",
        flush=True,
    )


if __name__ == "__main__":
    run_stage(main)

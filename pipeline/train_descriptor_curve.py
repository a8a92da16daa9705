"""Stage ``train_descriptor_curve``: the descriptor in use at other lengths of the code, and without the Laplacian term.

In: the template and all shards of a garment. Out: a folder with a model file for each length of the curve (Wang 2019,
Fig. 7), trained for the epochs that the config's ``curve`` names, and one at the length in use without the Laplacian
term (Fig. 6), trained as the descriptor in use. All see its training frames; components are found once for all.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from datasets.splits import TRAIN
from garments.template import GarmentTemplate
from models.descriptor_fitting import PrincipalFrames, fit_shape_descriptor
from models.shape_descriptor import ShapeDescriptorConfig, save_shape_descriptor
from pipeline.sequence_data import canonical_frames, job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings

NO_LAPLACIAN = "no-laplacian"


def main(job: Job) -> None:
    """Train all, into a folder beside the final one that a killed job continues in; then move it there."""
    template, *shards = job.inputs
    model, variant = job.spec["model"], job.spec["variant"]
    faces = GarmentTemplate.load(template).faces
    training = canonical_frames(job_sequences(job, shards, (TRAIN,)), job_body(job))
    settings = training_settings(job, model)
    config = settings_of(ShapeDescriptorConfig, model, variant=variant)
    frames = None
    if variant != "paper":
        frames = PrincipalFrames.of(training, faces, config.components, settings.seed)
    final = Path(job.outputs[0])
    made = final.with_name(f".{final.name}.made")
    work = final.with_name(f".{final.name}.work")
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    for name, changes in curve_changes(job.spec["codes"]).items():
        own = settings_of(ShapeDescriptorConfig, model | changes, variant=variant)
        # What differs in the Laplacian term alone is trained as long as what it is held against.
        trained = settings if name == NO_LAPLACIAN else replace(settings, epochs=job.spec["epochs"])
        progress = TrainingProgress(f"{job.spec['garment']} shape descriptor {variant} {name}")
        module = fit_shape_descriptor(training, faces, own, trained, work / name, progress=progress, frames=frames)
        save_shape_descriptor(made / f"{name}.pt", module)
    shutil.rmtree(final, ignore_errors=True)
    os.replace(made, final)
    shutil.rmtree(work, ignore_errors=True)


def curve_changes(codes: list[int]) -> dict[str, dict[str, float]]:
    """Names of the curve's models, and in what each differs from the variant in use."""
    return {str(code): {"code": code} for code in codes} | {NO_LAPLACIAN: {"laplacian_weight": 0.0}}


if __name__ == "__main__":
    run_stage(main)

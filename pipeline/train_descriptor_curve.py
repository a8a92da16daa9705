"""Stage ``train_descriptor_curve``: the descriptor in use at other lengths of the code, and without the Laplacian term.

In: the template and all shards of a garment. Out: a folder with a model file for each length of the curve (Wang 2019,
Fig. 7), in the size and trained as the config's ``curve`` says, and one at the length in use without the Laplacian term
(Fig. 6), otherwise the descriptor in use. All see its training frames; components are found once for all.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets.splits import TRAIN
from garments.template import GarmentTemplate
from models.descriptor_fitting import PrincipalFrames, fit_shape_descriptor
from models.shape_descriptor import ShapeDescriptorConfig, save_shape_descriptor
from models.training import TrainingSettings
from pipeline.sequence_data import canonical_frames, job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, values_of

NO_LAPLACIAN = "no-laplacian"


def main(job: Job) -> None:
    """Train all, into a folder beside the final one that a killed job continues in; then move it there."""
    template, *shards = job.inputs
    model, variant = job.spec["model"], job.spec["variant"]
    faces = GarmentTemplate.load(template).faces
    training = canonical_frames(job_sequences(job, shards, (TRAIN,)), job_body(job))
    in_use, curve = training_settings(job, model), job.spec["curve"]
    on_curve = replace(in_use, **values_of(TrainingSettings, curve))
    configs = {
        name: settings_of(ShapeDescriptorConfig, section, variant=variant)
        for name, section in curve_sections(model, curve).items()
    }
    frames = None
    if variant != "paper":
        most = max(config.components for config in configs.values())
        frames = PrincipalFrames.of(training, faces, most, in_use.seed)
    final = Path(job.outputs[0])
    made = final.with_name(f".{final.name}.made")
    work = final.with_name(f".{final.name}.work")
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    for name, config in configs.items():
        # What differs in the Laplacian term alone is trained as what it is held against.
        settings = in_use if name == NO_LAPLACIAN else on_curve
        of_it = frames.first(config.components) if frames else None
        progress = TrainingProgress(f"{job.spec['garment']} shape descriptor {variant} {name}")
        module = fit_shape_descriptor(training, faces, config, settings, work / name, progress=progress, frames=of_it)
        save_shape_descriptor(made / f"{name}.pt", module)
    shutil.rmtree(final, ignore_errors=True)
    os.replace(made, final)
    shutil.rmtree(work, ignore_errors=True)


def curve_sections(model: Mapping[str, Any], curve: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Names of the curve's models, and the config section of each.

    Args:
        model: Section of the descriptor in use.
        curve: Lengths of the codes, and what else is otherwise at every length.
    """
    size = {name: curve[name] for name in ("hidden", "components") if name in curve}
    sections = {str(code): {**model, **size, "code": code} for code in curve["codes"]}
    return sections | {NO_LAPLACIAN: {**model, "laplacian_weight": 0.0}}


if __name__ == "__main__":
    run_stage(main)

"""Stage ``train_gsnet``: one network that dresses motions in garments of any topology (Peng 2023), or a baseline of it.

In: the templates and shards of the wardrobe. Out: a model file and the table of losses. Trained on the templates and
takes that may be trained on, watched on held-out takes; networks of single garments (PBNS, TailorNet) are made for the
templates that are trained on.
"""

from __future__ import annotations

import torch

from models.gsnet import GSNetConfig
from models.gsnet_anchor import AnchorSettings
from models.gsnet_baselines import BASELINES, BaselineConfig
from models.gsnet_fitting import AnimatorTraining, build_animator, fit_animator, save_animator
from pipeline.gsnet_data import wardrobe_examples
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, values_of, work_dir
from pipeline.wardrobe_data import TRAIN, UNSEEN_MOTIONS, job_wardrobe

WATCHED = 1
"""Held-out sequences of each garment that training is watched on."""


def main(job: Job) -> None:
    """Train and save."""
    body, model, names = job_body(job), job.spec["model"], tuple(job.spec["wardrobe"]["materials"])
    garments = job_wardrobe(job, (TRAIN, UNSEEN_MOTIONS))
    training = wardrobe_examples(garments, (TRAIN,), body, names)
    if not training:
        raise ValueError("wardrobe: no simulated sequence may be trained on; were all of them dropped?")
    watched = [
        example
        for garment in garments
        for example in wardrobe_examples([garment], (UNSEEN_MOTIONS,), body, names)[:WATCHED]
    ]
    anchor = AnchorSettings(**model.get("anchor", {}))
    settings = settings_of(AnimatorTraining, model, training=training_settings(job, model), anchor=anchor)
    torch.manual_seed(settings.training.seed)
    kind = model["kind"]
    config = values_of(BaselineConfig if kind in BASELINES else GSNetConfig, model)
    config |= {"materials": names, "body": body.digest}
    if kind in BASELINES:
        config["garments"] = {e.graph.name: len(e.graph.vertices) for e in training}
    animator = build_animator(kind, config)
    progress = TrainingProgress(f"gsnet {job.spec['variant']}")
    fit_animator(animator, training, body, settings, work_dir(job.outputs[1]), watched, progress)
    save_animator(job.outputs[0], animator)


if __name__ == "__main__":
    run_stage(main)

"""Stage ``train_mesh_vae_gan``: one variant of the conditional Mesh VAE-GAN, or of its predecessor (Ma 2019).

In: the levels of the body mesh and the layer files of all types. Out: a model file and the table of losses. Trained on
seen bodies and seen clips; watched on bodies and clips that are both unseen.
"""

from __future__ import annotations

import numpy as np

from datasets.splits import TRAIN, UNSEEN_BODIES_AND_MOTIONS
from geometry.mesh_hierarchy import MeshHierarchy
from models.mesh_vae_gan import MeshVaeGanConfig
from models.mesh_vae_gan_fitting import fit_mesh_vae_gan, save_mesh_vae_gan
from pipeline.layer_data import job_layers
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, training_settings, values_of, work_dir

VALIDATION_FRAMES = 100


def main(job: Job) -> None:
    """Train and save."""
    hierarchy, *layers = job.inputs
    model, variant, body = job.spec["model"], job.spec["variant"], job_body(job)
    examples = job_layers(job, layers)
    training = examples.chosen(examples.split == TRAIN)
    if not len(training):
        raise ValueError("mesh VAE-GAN: no simulated frame in split train; were all simulations dropped?")
    held_out = np.flatnonzero(examples.split == UNSEEN_BODIES_AND_MOTIONS)
    config = MeshVaeGanConfig(
        **{"kind": "paper"} | values_of(MeshVaeGanConfig, model),
        types=examples.types,
        body_name=body.name,
        body_digest=body.digest,
    )
    module, _ = fit_mesh_vae_gan(
        training,
        MeshHierarchy.load(hierarchy),
        body,
        config,
        model["batch"],
        training_settings(job, model),
        work_dir(job.outputs[1]),
        validation=examples.chosen(held_out[:: -(-len(held_out) // VALIDATION_FRAMES)] if len(held_out) else held_out),
        progress=TrainingProgress(f"mesh VAE-GAN {variant}"),
    )
    save_mesh_vae_gan(job.outputs[0], module)


if __name__ == "__main__":
    run_stage(main)

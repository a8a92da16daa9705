"""Stage ``train_motion_invariant``: the material, apart from how its wearer moves (Wang 2019, section 3.4).

In: the codes of a garment and the shape descriptor in use, which made them. Out: a model file and the table of losses.
Trained on both plans: the materials plan shows many parameter sets, and the motions plan, one set more, shows many
motions. Watched where both are unseen.
"""

from __future__ import annotations

from datasets.codes import file_digest
from datasets.shards import MATERIALS
from datasets.splits import TRAIN, UNSEEN_BOTH
from models.intrinsic_fitting import TrainedOn, fit_motion_invariant, save_motion_invariant
from models.motion_invariant import MotionInvariantConfig
from pipeline.intrinsic_data import all_codes, intrinsic_frames, job_codes, varied_parameters
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, work_dir


def main(job: Job) -> None:
    """Train and save."""
    codes_path, descriptor_path = job.inputs
    model, variant = dict(job.spec["model"]), job.spec["variant"]
    kind = model.pop("kind", variant)
    config = settings_of(MotionInvariantConfig, {"window": job.spec["window"]} | model, variant=kind)
    training = job_codes(job, codes_path, descriptor_path, (TRAIN,))
    held_out = job_codes(job, codes_path, descriptor_path, (UNSEEN_BOTH,), (MATERIALS,))
    names = varied_parameters(training)
    frames, validation = (
        intrinsic_frames(sequences, all_codes(sequences), config, names) for sequences in (training, held_out)
    )
    module = fit_motion_invariant(
        frames,
        config,
        training_settings(job, model),
        work_dir(job.outputs[1]),
        validation=validation,
        progress=TrainingProgress(f"{job.spec['garment']} motion-invariant {variant}"),
    )
    trained_on = TrainedOn(job.spec["garment"], file_digest(descriptor_path))
    save_motion_invariant(job.outputs[0], module, trained_on)


if __name__ == "__main__":
    run_stage(main)

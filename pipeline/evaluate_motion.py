"""Stage ``evaluate_motion``: how well the motion generators reconstruct and invent (Shi 2023, Tables 3, 4, 5 and 8).

In: the recognition network, all variants of the motion CVAE with the baselines, the losses of these trainings, and all
motion batches. Out: the tables ``motion_reconstruction``, ``motion_generation`` and ``motion_quality``.
"""

from __future__ import annotations

from pathlib import Path

from evaluation.motion import MotionSet, generation_rows, reconstruction_rows, sampling
from evaluation.motion_quality import quality_rows
from evaluation.seeds import average_seeds, split_seed
from evaluation.table import Row, read_table, write_table
from models.motion_fitting import load_motion_cvae, load_recognition
from models.motion_generator import MotionGenerator
from pipeline.motion_data import labelled_motions, split_clips
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage

NAMES = {"actor": "ACTOR", "action2motion": "Action2Motion"}


def main(job: Job) -> None:
    """Evaluate on the held-out clips."""
    spec, count = job.spec, len(job.spec["variants"])
    recognition_path, *inputs = job.inputs
    paths, (judge_losses, *losses), motions = inputs[:count], inputs[count : 2 * count + 1], inputs[2 * count + 1 :]
    body, recognition = job_body(job), load_recognition(recognition_path)
    models = {_name(path): load_motion_cvae(path) for path in paths}
    budgets = {
        _name(path): _budget(spec["motion_cvae"]["variants"][split_seed(Path(path).stem)[0]], models[_name(path)], rows)
        for path, rows in zip(paths, losses, strict=True)
    }
    clips, held_out = split_clips(job, motions)
    train, test = (
        MotionSet(poses, tuple(labels), spec["fps"]) for poses, labels, _ in map(labelled_motions, (clips, held_out))
    )
    print(f"[motion] {len(train.labels)} training and {len(test.labels)} held-out clips", flush=True)
    rows = reconstruction_rows(models, train, test, body)
    rows = [row | budgets.get(row["method"], {}) for row in rows]
    write_table(job.outputs[0], average_seeds(rows, ["vertex_rmse_m", "joint_error_m"]))
    print("[motion] reconstruction done", flush=True)
    rows = generation_rows(models, recognition, train, test, body, spec["seed"], spec["evaluation"]["repetitions"])
    size, trained = recognition.config, spec["recognition"]["training"]["epochs"]
    judge = {
        "judge": f"GRU {size.layers} x {size.width}, {size.features} features, {trained} epochs",
        "judge_training_s": _seconds(judge_losses),
        "data": spec["source"],
    }
    rows = [row | judge | budgets.get(row["source"], {}) for row in rows]
    write_table(job.outputs[1], average_seeds(rows, ["fid", "accuracy_percent", "diversity", "multimodality"]))
    print("[motion] generation done", flush=True)
    frames = train.pose6d.shape[1]
    generated = {name: m.sample_motions(test.labels, frames, sampling(spec["seed"], 0)) for name, m in models.items()}
    rows = quality_rows(held_out, generated, body)
    write_table(job.outputs[2], average_seeds(rows, []))


def _name(path: str) -> str:
    """What the tables call a generator; a repetition from another seed keeps the mark of it."""
    variant, number = split_seed(Path(path).stem)
    name = NAMES.get(variant, f"motion CVAE, {variant}")
    return name if number == 1 else f"{name}-seed-{number}"


def _budget(settings: dict, model: MotionGenerator, losses: str) -> Row:
    """What a generator cost: the columns that make a comparison fair or not."""
    training = settings["training"]
    return {
        "vertex_weight": settings.get("vertex_weight", 0.0),
        "parameters": sum(p.numel() for p in model.parameters()),
        "epochs": training["epochs"],
        "batch": settings["batch"],
        "training_s": _seconds(losses),
        "training_seeds": 1,
    }


def _seconds(losses: str) -> float:
    """Seconds that a training took, without its validations."""
    return sum(float(row["seconds"]) for row in read_table(losses) if row["split"] == "train")


if __name__ == "__main__":
    run_stage(main)

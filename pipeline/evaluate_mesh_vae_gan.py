"""Stage ``evaluate_mesh_vae_gan``: Table 1 of Ma 2019 with its ablations, wrinkles, and what is generated.

In: all variants and the layer files of all types. Out: two tables. ``mesh_vae_gan``: error of each network's
reconstruction on covered vertices, and how far its wrinkles are from the true ones, beside principal components of the
same length, of all types and of each, for new clips, new bodies and both. ``mesh_vae_gan_generation``: layers of random
z at poses and types of held-out frames: wrinkles, a linear judge's accuracy, time a layer.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from body.model import Body
from datasets.layers import LayerExamples
from datasets.splits import TRAIN, UNSEEN_BODIES, UNSEEN_BODIES_AND_MOTIONS, UNSEEN_MOTIONS
from evaluation.clothing_layer import Wrinkles, distribution_distance, judge_accuracy, vertex_errors
from evaluation.table import Row, write_table
from models.mesh_vae_gan import MeshVaeGan
from models.mesh_vae_gan_fitting import load_mesh_vae_gan
from models.pca import fit_pca
from pipeline.layer_data import job_layers
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage

SCENARIOS = (UNSEEN_MOTIONS, UNSEEN_BODIES, UNSEEN_BODIES_AND_MOTIONS)
"""Seen subject and unseen sequence, unseen subject and seen sequence, both unseen."""
MOST_FRAMES = 200
"""Frames of a scenario, evenly spread."""
TIMED = 20
"""Layers generated one by one; the fastest counts, for the machine may be busy with other things."""

ANCHORED = ("mean", "regression", "directions", "bases", "inverses")
"""Buffers that are fitted to the data, though by no gradient."""

Through = Callable[[LayerExamples], np.ndarray]


def main(job: Job) -> None:
    """Load, evaluate, write."""
    torch.set_num_threads(max(1, job.threads))
    spec, body = job.spec, job_body(job)
    count = len(spec["variants"])
    networks = {
        name: load_mesh_vae_gan(path, body) for name, path in zip(spec["variants"], job.inputs[:count], strict=True)
    }
    examples = job_layers(job, job.inputs[count:])
    training = examples.chosen(examples.split == TRAIN)
    tests = {split: scenario_frames(examples, split) for split in SCENARIOS}
    tests = {name: frames for name, frames in tests.items() if len(frames)}
    if not tests:
        raise ValueError("mesh VAE-GAN: no held-out frame was simulated, there is nothing to evaluate on")
    used = networks[spec["use"]]
    wrinkles = Wrinkles(
        body.vertices[examples.vertices], used.hierarchy.faces[0], body.part_of_vertex[examples.vertices]
    )
    numbers = training.displacements[0].size
    methods: dict[str, tuple[Through, int]] = {"mean layer": (_mean_of_type(training), len(training.types) * numbers)}
    pca, decode = _principal(training, used.config.latent, spec["seed"])
    methods[f"PCA, {used.config.latent}"] = (pca, (used.config.latent + 1) * numbers)
    parts = [training.chosen(training.type_index == k) for k in range(len(training.types))]
    if min(map(len, parts)) > 1:
        fitted = [_principal(part, used.config.latent, spec["seed"])[0] for part in parts]
        numbers_of_types = len(parts) * (used.config.latent + 1) * numbers
        methods[f"PCA a type, {used.config.latent}"] = (_by_type(fitted), numbers_of_types)
    for name, network in networks.items():
        methods[name] = (_network(network), _trained_numbers(network))
    write_table(job.outputs[0], reconstruction_rows(methods, tests, wrinkles, spec["use"]))
    hardest = list(tests.values())[-1]
    write_table(job.outputs[1], generation_rows(networks, decode, hardest, body, wrinkles, spec["seed"]))


def scenario_frames(examples: LayerExamples, split: str) -> LayerExamples:
    """Frames of a split, at most ``MOST_FRAMES``, evenly spread over types, bodies and clips."""
    rows = np.flatnonzero(examples.split == split)
    count = min(len(rows), MOST_FRAMES)
    return examples.chosen(rows[np.arange(count) * len(rows) // max(1, count)])


def reconstruction_rows(
    methods: dict[str, tuple[Through, int]], tests: dict[str, LayerExamples], wrinkles: Wrinkles, use: str
) -> list[Row]:
    """Table 1: a row for every scenario and method."""
    rows: list[Row] = []
    for split, frames in tests.items():
        covered = frames.covered[frames.type_index]
        truth = wrinkles.distribution(wrinkles.angles(frames.displacements), covered)
        for name, (through, parameters) in methods.items():
            found = through(frames)
            errors = vertex_errors(found, frames.displacements, covered)
            bent = wrinkles.distribution(wrinkles.angles(found), covered)
            rows.append(
                {
                    "split": split,
                    "method": name,
                    "in_use": name == use,
                    "frames": len(frames),
                    "error_mm": 1e3 * errors.mean,
                    "error_deviation_mm": 1e3 * errors.deviation,
                    "wrinkle_error_degrees": distribution_distance(bent, truth),
                    "parameters": parameters,
                }
            )
    return rows


def generation_rows(
    networks: dict[str, MeshVaeGan],
    linear: Callable[[np.ndarray], np.ndarray],
    frames: LayerExamples,
    body: Body,
    wrinkles: Wrinkles,
    seed: int,
) -> list[Row]:
    """Random layers of every network that has a condition, and of principal components, which have none."""
    covered = frames.covered[frames.type_index]
    names = [frames.types[k] for k in frames.type_index]
    sequences = frames.sequence.tolist()
    angles = wrinkles.angles(frames.displacements)
    truth, seen = wrinkles.distribution(angles, covered), wrinkles.statistics(angles, covered)
    generator = np.random.default_rng(seed)
    rows: list[Row] = []

    def judged(name: str, layers: np.ndarray, milliseconds: float | None) -> None:
        bent = wrinkles.angles(layers)
        rows.append(
            {
                "method": name,
                "frames": len(layers),
                "wrinkle_error_degrees": distribution_distance(wrinkles.distribution(bent, covered), truth),
                "judge_right_percent": 100.0 * judge_accuracy(seen, wrinkles.statistics(bent, covered), sequences, seed)
                if len(set(sequences)) > 1
                else None,
                "time_ms_per_frame": milliseconds,
                "vertices": len(body.vertices),
            }
        )

    length = next(iter(networks.values())).config.latent
    judged(f"PCA, {length}, random", linear(generator.standard_normal((len(frames), length))), None)
    for name, network in networks.items():
        if not network.config.conditional:
            continue
        z = generator.standard_normal((len(frames), network.config.latent))
        layers = np.concatenate(
            [
                network.generate(z[k : k + 64], frames.pose[k : k + 64], names[k : k + 64])[:, frames.vertices]
                for k in range(0, len(frames), 64)
            ]
        )
        judged(name, layers, 1e3 * fastest(network, frames.pose[:1], names[:1]))
    return rows


def fastest(network: MeshVaeGan, pose: np.ndarray, types: list[str]) -> float:
    """Processor time of one layer, from z, pose and type to displacements of the whole body [s]."""
    z, taken = np.zeros((1, network.config.latent)), []
    for _ in range(TIMED):
        start = time.process_time()
        network.generate(z, pose, types)
        taken.append(time.process_time() - start)
    return min(taken)


def _trained_numbers(network: MeshVaeGan) -> int:
    """Numbers fitted to the data that a layer takes: no discriminator's, nobody needs it after training."""
    fitted = [p for name, p in network.named_parameters() if not name.startswith("discriminator")]
    fitted += [value for name, value in network.named_buffers() if name in ANCHORED]
    return sum(one.numel() for one in fitted)


def _network(network: MeshVaeGan) -> Through:
    return lambda frames: network.reconstruct(
        frames.displacements, frames.pose, [frames.types[k] for k in frames.type_index]
    )


def _mean_of_type(training: LayerExamples) -> Through:
    rows = [training.displacements[training.type_index == k] for k in range(len(training.types))]
    means = np.stack([one.mean(axis=0) if len(one) else training.displacements.mean(axis=0) for one in rows])
    return lambda frames: means[frames.type_index]


def _by_type(fitted: list[Through]) -> Through:
    """Each frame by what was fitted to frames of its type."""

    def through(frames: LayerExamples) -> np.ndarray:
        found = np.empty_like(frames.displacements)
        for k, own in enumerate(fitted):
            rows = frames.type_index == k
            if rows.any():
                found[rows] = own(frames.chosen(rows))
        return found

    return through


def _principal(training: LayerExamples, length: int, seed: int) -> tuple[Through, Callable[[np.ndarray], np.ndarray]]:
    """Principal components of all types, and layers of their standardised coefficients."""
    shape = training.displacements.shape[1:]
    length = min(length, len(training) - 1)
    pca = fit_pca(training.displacements.reshape(len(training), -1), length, seed)

    def through(frames: LayerExamples) -> np.ndarray:
        return pca.decode(pca.encode(frames.displacements.reshape(len(frames), -1))).reshape(-1, *shape)

    def decode(z: np.ndarray) -> np.ndarray:
        return pca.decode((z[:, :length] * pca.deviations).astype(np.float32)).reshape(-1, *shape)

    return through, decode


if __name__ == "__main__":
    run_stage(main)

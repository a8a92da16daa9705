"""Stage ``compare_systems``: all four systems side by side on the garment that all can dress.

In: the garment's template, simulations and trained networks of its own; GSNet's, trained on the wardrobe; the Mesh
VAE-GAN's, trained on outfits as layers of the body; the run's timings. Out: the table ``systems``, and a picture of one
frame dressed by the simulator and by each system.

All are asked for the same sequences: held-out clips in the base material, and held-out clips in held-out materials.
What each is told is in the table (``pipeline.systems_data`` says how). The Mesh VAE-GAN moves the body's vertices: its
layer is held against the true layer at these, and carried to the garment's vertices for all other figures; the row
``layer of the truth`` is what that way costs.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from collections.abc import Sequence as Many
from pathlib import Path

import numpy as np
import torch
from torch import nn

from body.model import Body, skin
from datasets.atomic import atomic_folder
from datasets.sequences import Sequence, load_sequences
from datasets.shards import MATERIALS, MOTIONS, REPEATED, read_header
from datasets.splits import TRAIN, UNSEEN_BOTH, UNSEEN_MOTIONS, UNSEEN_PARAMETERS, SplitRule
from evaluation.baselines import ROTATION_OFFSETS, PcaFloor, RidgeRegression, SimulatedAgain, SkinnedTemplate
from evaluation.regressor import Predictor, RegressorEvaluation
from evaluation.systems import System, held, system_rows
from evaluation.table import Row, read_table, write_table
from garments.body_layer import cast_layer
from garments.layer_wearing import LayerWearing
from garments.template import GarmentTemplate
from models.conditioned_regressor import ConditionedRegressor
from models.gsnet_fitting import load_animator
from models.intrinsic_fitting import load_motion_invariant
from models.mesh_vae_gan_fitting import load_mesh_vae_gan
from models.refinement import RefinementSettings
from models.shape_descriptor import load_shape_descriptor
from pipeline.garment_predictors import load_variant, regressor_predictor
from pipeline.intrinsic_data import job_codes, varied_parameters
from pipeline.progress import Progress
from pipeline.sequence_data import job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.systems_data import (
    WornLayer,
    animator_predictor,
    check_shards,
    material_predictor,
    nearest_type,
    sizes,
    z_sources,
)
from report.camera import Framing, View
from report.render import SceneRenderer, worn_colours
from report.sheets import contact_sheet, write_image

SHI, WANG, PENG, MA = "Shi 2023", "Wang 2019", "Peng 2023", "Ma 2019"
FLOOR = "baseline"
PAPERS = {"garment_regressor": SHI, "motion_invariant": WANG, "gsnet": PENG, "mesh_vae_gan": MA}
"""Whose each model is, in the order of the inputs, of the table and of the picture."""

PAPER = "paper"
"""Variant that follows the paper."""

TESTS = 8
"""Sequences of a split, evenly spread, that systems are tested on."""

DETAILED = 2
"""Of these, sequences of which more than the errors is computed."""

VIEW = View(azimuth=25.0, elevation=6.0, margin=0.10)


class Inputs:
    """The files of the job in their groups, handed out in the order of the rule."""

    def __init__(self, job: Job) -> None:
        self._left: Iterator[str] = iter(job.inputs)

    def one(self) -> str:
        """The next file."""
        return next(self._left)

    def named(self, names: Many[str]) -> dict[str, str]:
        """As many of the next files as there are names."""
        return {name: next(self._left) for name in names}

    def rest(self) -> list[str]:
        """What is left."""
        return list(self._left)


def main(job: Job) -> None:
    """Load all systems, evaluate them on the same sequences, draw one frame."""
    torch.set_num_threads(1)
    spec, variants, inputs = job.spec, job.spec["variants"], Inputs(job)
    body, template = job_body(job), GarmentTemplate.load(inputs.one())
    descriptor_path, codes_path, repeated, timing = (inputs.one() for _ in range(4))
    outfits = {kind: GarmentTemplate.load(path) for kind, path in inputs.named(spec["types"]).items()}
    models = {model: inputs.named(variants[model]) for model in PAPERS}
    seconds = {model: {v: _seconds(p) for v, p in inputs.named(variants[model]).items()} for model in PAPERS}
    below = _seconds(inputs.one())  # of the descriptor that Wang's autoencoders stand on
    shards = inputs.rest()

    check_shards([repeated, *shards], template)
    training, test = _sequences(job, shards)
    layer = cast_layer(template, body)
    kind, trusted = nearest_type(layer, outfits, body)
    wearing = LayerWearing(template, body, layer, trusted)
    again = load_sequences([repeated], SplitRule(**spec["splits"]), plans=(REPEATED,))
    own = spec["trained_on"]

    def costs(model: str, variant: str, trained_on: str, *networks: nn.Module, more_s: float = 0.0) -> Row:
        saw = trained_on.startswith("own")
        return _costs(sizes(*networks), own[trained_on], seconds[model][variant] + more_s, saw)

    systems = floors(training, again, body, template, wearing, _simulator_ms(timing), own["own motions"])
    for variant, path in models["garment_regressor"].items():
        regressor = load_variant(variant, path)
        told = isinstance(regressor, ConditionedRegressor)
        took = costs("garment_regressor", variant, "own, all" if told else "own motions", regressor)
        what = "motion, material" if told else "motion"
        systems.append(System(SHI, variant, regressor_predictor(regressor), what, variant == PAPER, costs=took))
    descriptor = load_shape_descriptor(descriptor_path, template.faces)
    coded = job_codes(job, codes_path, descriptor_path, (TRAIN, UNSEEN_PARAMETERS))
    for variant, path in models["motion_invariant"].items():
        network = load_motion_invariant(path)
        took = costs("motion_invariant", variant, "own materials", network, descriptor, more_s=below)
        predict = material_predictor(network, descriptor, z_sources(coded), varied_parameters(coded))
        systems.append(System(WANG, variant, predict, "motion, z of other clips", variant == PAPER, costs=took))
    for variant, path in models["gsnet"].items():
        animator = load_animator(path)
        took, predict = costs("gsnet", variant, "wardrobe", animator), animator_predictor(animator, template, body)
        systems.append(System(PENG, variant, predict, "motion, material, template", variant == PAPER, costs=took))
    for variant, path in models["mesh_vae_gan"].items():
        worn = WornLayer(load_mesh_vae_gan(path, body), body, kind, wearing)
        systems += layered_systems(variant, worn, costs("mesh_vae_gan", variant, "layers", worn.network), training)
    del training

    progress = Progress("compare systems", len(test) * len(systems), "sequences")
    settings = RegressorEvaluation(
        frames_stride=spec["evaluation"]["frames_stride"],
        detailed=DETAILED,
        refinement=RefinementSettings(**spec["refinement"]),
    )
    rows = system_rows(test, systems, body, template, wearing, settings, progress)
    progress.finish()
    write_table(job.outputs[0], [{"garment": spec["garment"]} | row for row in rows])
    with atomic_folder(job.outputs[1]) as folder:
        draw(job, folder, test, systems, body, template)


def floors(
    training: Many[Sequence],
    again: Many[Sequence],
    body: Body,
    template: GarmentTemplate,
    wearing: LayerWearing,
    simulator_ms: float | None,
    trained_on: Many[int],
) -> list[System]:
    """What needs no network: the simulator, skinning, a linear map; and what bounds the others from below."""

    def skinned(sequence: Sequence) -> np.ndarray:
        transforms = body.joint_transforms(sequence.pose, sequence.root)
        return skin(template.vertices, template.skin_index, template.skin_weight, transforms)

    def simulated_again(sequence: Sequence) -> np.ndarray | None:
        return second.predict(sequence) if sequence.phi == 0 else None  # of other materials there is no second run

    def layered(sequence: Sequence) -> np.ndarray:
        return wearing.garment(wearing.points(sequence.vertices), sequence.pose, sequence.root)

    def blind(name: str, predict: Predictor, told: str, timed: bool = False, costs: Row | None = None) -> System:
        return System(FLOOR, name, predict, told, timed=timed, costs=costs or {})

    seen, second = _costs({}, trained_on, None), SimulatedAgain(again)
    residual = SkinnedTemplate(body, template).fit(training)
    ridge = RidgeRegression(ROTATION_OFFSETS, rotations=True).fit(training)
    dimensions = min(200, sum(s.frames for s in training) - 1)
    pca = PcaFloor(dimensions).fit(training)
    return [
        blind("simulation", lambda s: s.vertices, "the truth", costs={"time_ms_per_frame": simulator_ms}),
        blind("simulated again (chaos floor)", simulated_again, "motion, material"),
        blind("linear blend skinning", skinned, "pose", timed=True),
        blind("linear blend skinning + mean residual", residual.predict, "pose", timed=True, costs=seen),
        blind("ridge regression, pose history", ridge.predict, "motion", timed=True, costs=seen),
        blind(f"PCA-{dimensions} of the truth", pca.predict, "the truth", costs=seen),
        blind("layer of the truth", layered, "the truth"),
    ]


def layered_systems(variant: str, worn: WornLayer, costs: Row, training: Many[Sequence]) -> list[System]:
    """The Mesh VAE-GAN as it is, with the mean of what it misses of this garment, and through its encoder."""
    fitted, seen = worn.with_mean_residual(training), costs | {"saw_this_garment": True}

    def system(what: str, predict: Predictor, points: Predictor, told: str, took: Row, timed: bool = True) -> System:
        return System(MA, f"{variant}{what}", predict, told, variant == PAPER, points, timed, took)

    return [
        system("", worn.predict, worn.points, "pose, type", costs),
        system(" + mean residual", fitted.predict, fitted.points, "pose, type, mean", seen),
        system(", reconstruction", worn.reconstructed, worn.reconstructed_points, "the truth", costs, timed=False),
    ]


def draw(
    job: Job, folder: Path, test: Many[Sequence], systems: Many[System], body: Body, template: GarmentTemplate
) -> None:
    """The frame in which the simulated garment is farthest from its skinned template, dressed by all, side by side."""
    garment, use, size = job.spec["garment"], job.spec["use"], (job.spec["report"]["width"] // 2,) * 2
    named = {(s.paper, s.method): s.predict for s in systems}
    skinned, truth = named[FLOOR, "linear blend skinning"], named[FLOOR, "simulation"]
    candidates = [s for s in test if s.split == UNSEEN_MOTIONS] or list(test)
    apart = [np.linalg.norm(s.vertices - skinned(s), axis=2).mean(axis=1) for s in candidates]
    number = int(np.argmax([a.max() for a in apart]))
    sequence, frame = candidates[number], int(apart[number].argmax())
    columns, lines = ["simulation"], {"as published": [truth], "ours": [truth]}
    for model, paper in PAPERS.items():
        columns.append(paper)
        for line, variant in (("as published", PAPER), ("ours", use[model])):
            lines[line].append(named.get((paper, variant)))
    lines = {name: row for name, row in lines.items() if all(row)}
    posed = body.posed(sequence.pose[frame : frame + 1], sequence.root[frame : frame + 1])
    framing = Framing.of(sequence.vertices[frame : frame + 1], VIEW, size)
    with SceneRenderer(template.faces, body.faces, size, worn_colours(template.worn_as, template.layer)) as scene:
        rows = [
            [scene.frame(held(one(sequence), sequence)[frame], posed[0], framing) for one in row]
            for row in lines.values()
        ]
    image = contact_sheet(rows, list(lines), columns)
    write_image(folder / "systems.webp", image)
    text = f"{sequence.label}, frame {frame}: where the simulated garment is farthest from the skinned template."
    entry = {
        "file": "systems.webp",
        "kind": "systems",
        "title": "One frame, dressed by all",
        "caption": f"{text} No vertex is projected out of the body.",
        "alt": f"The {garment} on the same body and frame, simulated and predicted by four systems",
        "label": sequence.label,
        "clip": sequence.clip,
        "width": int(image.shape[1]),
        "height": int(image.shape[0]),
        "animated": False,
    }
    (folder / "figures.json").write_text(json.dumps({"garment": garment, "figures": [entry]}, indent=1))


def _sequences(job: Job, shards: list[str]) -> tuple[list[Sequence], list[Sequence]]:
    """Training sequences in the base material, and those of each test split, evenly spread."""
    found = job_sequences(job, shards, (TRAIN, UNSEEN_MOTIONS), (MOTIONS,))
    clips, rule = set(job.spec["tested_clips"]), SplitRule(**job.spec["splits"])
    held_out = [s for s in found if s.split == UNSEEN_MOTIONS]
    tests = [[s for s in held_out if s.clip in clips] or held_out]
    # Two shards hold enough: the first and the last, whose clips are not the same; more where they do not.
    varied: list[Sequence] = []
    materials = [shard for shard in shards if read_header(shard).plan == MATERIALS]
    for shard in dict.fromkeys([*materials[:1], *materials[-1:], *materials]):
        if len(varied) < TESTS:
            varied += load_sequences([shard], rule, (UNSEEN_BOTH,), (MATERIALS,))
    tests.append(varied)
    test = []
    for some in tests:
        count = min(TESTS, len(some))
        test += [some[i * len(some) // count] for i in range(count)]
    return [s for s in found if s.split == TRAIN], test


def _costs(size: Row, trained_on: Many[int], seconds: float | None, saw: bool = True) -> Row:
    """Columns of what a system took to train."""
    garments, sequences = trained_on
    trained = {"trained_garments": garments, "trained_sequences": sequences, "saw_this_garment": saw}
    return size | {"training_s": seconds} | trained


def _seconds(path: str) -> float:
    """Wall time [s] of the whole job from its benchmark: the processor time there is sampled, and misses the end."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return float(next(csv.DictReader(file, delimiter="\t"))["s"])
    except (StopIteration, KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: not a benchmark of a job, it has no row with the column 's'") from None


def _simulator_ms(path: str) -> float | None:
    """Milliseconds a frame of the simulator, one at a time, with self-contact where that was timed."""
    rows = {str(row.get("solver")): row.get("median_s_per_frame") for row in read_table(path)}
    for solver in ("XPBD with self-contact", "XPBD"):
        if isinstance(rows.get(solver), int | float):
            return 1e3 * float(rows[solver])
    return None


if __name__ == "__main__":
    run_stage(main)

"""Stage ``render``: pictures of one garment.

In: the template, the motion CVAE, the collision-tuned regressor and all shards of the garment. Out: a folder of
pictures with their list ``figures.json``. Which sequences are shown is a function of the shards' names and figures
alone; only those are read. What the data cannot show (no unseen motion, no collision) is left out and named in the
list.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from collections.abc import Sequence as Many
from pathlib import Path

import numpy as np
import torch

from body.model import Body
from datasets.atomic import atomic_folder
from datasets.sequences import Sequence, load_sequences
from datasets.shards import MATERIALS, MOTIONS, read_header, read_quality
from datasets.splits import SplitRule
from evaluation.metrics import rmse
from garments.template import GarmentTemplate
from models.garment_fitting import load_regressor
from models.garment_regressor import Regressor
from models.motion_features import MotionTrack
from models.motion_fitting import load_motion_cvae
from models.refinement import RefinementSettings, Refiner
from pipeline.garment_predictors import regressor_predictor
from pipeline.motion_data import generated_tracks
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from report.gallery import Dressed, Gallery, round_scale
from report.render import worn_colours

LIVELY = (
    "dance-step", "twist", "jumping-jack", "turn-left", "kick", "run", "dance-sway", "hip-circle", "lunge", "walk-fast",
    "march", "walk", "squat",
)  # fmt: skip
"""Motions that show what cloth does, the best first; others follow in the order of the data."""

CONTACT_ROWS, CONTACT_COLUMNS = 4, 5
MATERIAL_SETS = 3
SEEN_MATERIALS = ("bend", "density", "stretch", "air_drag")
"""Parameters that an eye can tell, by which parameter sets are chosen and named."""


def main(job: Job) -> None:
    """Draw everything into a folder beside the final one, then move it there."""
    torch.set_num_threads(max(1, job.threads))
    with atomic_folder(job.outputs[0]) as folder:
        draw(job, folder)


def draw(job: Job, folder: Path) -> None:
    """All pictures, in the order of the page."""
    spec, settings = job.spec, job.spec["report"]
    template_path, cvae_path, regressor_path, *shards = job.inputs
    body, template, data = job_body(job), GarmentTemplate.load(template_path), Data(shards, SplitRule(**spec["splits"]))
    regressor = load_regressor(regressor_path)
    refiner = Refiner(template.topology, body.faces, len(body.vertices), RefinementSettings(**spec["refinement"]))
    size = (settings["width"], settings["height"])
    colours = worn_colours(template.worn_as, template.layer)
    gallery = Gallery(folder, spec["garment"], colours, template.faces, body.faces, size, spec["fps"])
    shown, frames = settings["sequences"], settings["video_frames"]
    absent = []

    say(job, "template and simulated sequences")
    gallery.hero(template.vertices, body.vertices)
    lively = data.lively(CONTACT_ROWS)
    simulated = [dressed(s, body) for s in data.read(lively)]
    for sequence, one in zip(lively[:shown], simulated[:shown]):
        gallery.animation("simulated", one.cut(frames), f"Simulated: {one.label}", _clip_words(sequence))
    if simulated:
        gallery.contact([(d.label, d) for d in simulated], CONTACT_COLUMNS, "Base material; time runs to the right.")
    else:
        absent.append("every simulation with the base material was dropped")

    say(job, "materials")
    if not draw_materials(gallery, data, body, frames):
        absent.append(f"fewer than {MATERIAL_SETS} parameter sets of one clip were simulated")

    say(job, "predictions")
    unseen = data.read(data.lively(shown, spec["held_out_clips"]))
    if not unseen:
        absent.append("no motion of the test split was simulated")
    elif not draw_predictions(gallery, unseen, body, regressor, refiner, frames):
        absent.append("no predicted garment is inside the body in the motions shown, so there is nothing to refine")

    say(job, "generated motions")
    labels = sorted(spec["labels"], key=_rank)
    generator = torch.Generator().manual_seed(spec["seed"])
    cvae = load_motion_cvae(cvae_path)
    tracks = generated_tracks(cvae, labels[:shown], spec["frames"], spec["fps"], spec["lead_in"], body, generator)
    for number, track in enumerate(tracks):
        one, inside = dress_generated(track, labels[number], number, body, regressor, refiner)
        gallery.animation(
            "generated",
            one.cut(frames),
            f"Generated: {one.label}",
            "No simulator: motion, garment and refinement are predicted.",
            inside_before_refinement_percent=inside,
        )
    gallery.write(absent=absent)


def draw_materials(gallery: Gallery, data: Data, body: Body, frames: int) -> bool:
    """The clip with the most parameter sets, under the three that differ most; False where there are not three."""
    chosen = data.materials()
    if len(chosen) < MATERIAL_SETS:
        return False
    sets = [dressed(s, body).cut(frames) for s in data.read(chosen)]
    names = [f"parameter set {row['phi']}" for row in chosen]
    apart = [
        np.linalg.norm(a.garment - b.garment, axis=2).mean(axis=1) for a, b in itertools.combinations(sets, 2)
    ]  # 3 x [T]
    frame = int(np.min(apart, axis=0).argmax())
    words = "; ".join(f"set {row['phi']}: {_material_words(row)}" for row in chosen)
    caption = f"Same motion ({chosen[0]['clip']}). {words}."
    numbers = {f"set_{row['phi']}_{name}": float(row[f"parameter_{name}"]) for row in chosen for name in SEEN_MATERIALS}
    gallery.materials(list(zip(names, sets)), frame, caption, **numbers)
    return True


def draw_predictions(
    gallery: Gallery, sequences: Many[Sequence], body: Body, regressor: Regressor, refiner: Refiner, frames: int
) -> bool:
    """Truth, prediction and error; the frame with the most collisions before and after refinement, if it has any."""
    predict = regressor_predictor(regressor)
    worst: tuple[int, int, Dressed, np.ndarray] | None = None
    for sequence in sequences:
        truth, predicted = dressed(sequence, body).cut(frames), predict(sequence)[:frames]
        distance = np.linalg.norm(predicted - truth.garment, axis=2)
        largest = round_scale(float(np.percentile(distance, 98)))
        error = 1e3 * rmse(predicted, truth.garment)
        gallery.error(
            truth,
            predicted,
            largest,
            f"Clip {sequence.clip}, not trained on: RMSE {error:.1f} mm over {len(predicted)} frames.",
            int(np.argsort(distance.mean(axis=1))[len(distance) // 2]),
            rmse_mm=error,
            largest_colour_mm=1e3 * largest,
        )
        refined = np.empty_like(predicted)
        for t, vertices in enumerate(predicted):
            refined[t], stats = refiner.refine_frame(vertices, truth.body[t])
            if stats.inside and (worst is None or stats.inside > worst[0]):
                worst = stats.inside, t, Dressed(predicted, truth.body, truth.clip, truth.label), refined
    if worst is None:
        return False
    inside, frame, before, after = worst
    moved = 1e3 * float(np.linalg.norm(after[frame] - before.garment[frame], axis=1).max())
    caption = f"Frame {frame} of {before.clip}: {inside} of {before.garment.shape[1]} vertices were inside the body."
    gallery.refined(before, after, frame, caption, vertices_inside=inside, largest_move_mm=moved)
    return True


def dress_generated(
    track: MotionTrack, label: str, number: int, body: Body, regressor: Regressor, refiner: Refiner
) -> tuple[Dressed, float]:
    """A generated motion, dressed and refined, and the share of vertices inside before [%]."""
    garment = track.in_world(regressor.dress(track))
    body_vertices = body.posed(track.pose[track.lead :], track.joints[track.lead :, 0] - body.joints[0])
    refined, stats = refiner.refine_sequence(garment, body_vertices)
    inside = 100.0 * stats.inside / garment[..., 0].size
    return Dressed(refined, body_vertices, f"generated_{number:02d}", label), inside


def dressed(sequence: Sequence, body: Body) -> Dressed:
    """A simulated sequence with its body."""
    return Dressed(sequence.vertices, body.posed(sequence.pose, sequence.root), sequence.clip, sequence.label)


class Data:
    """What the shards hold, by their small figures; arrays are read for single sequences.

    Args:
        shards: Paths.
        rule: Which sequences are held out.
    """

    def __init__(self, shards: Many[str], rule: SplitRule) -> None:
        self.rule = rule
        self.rows: list[dict] = []
        for path in shards:
            plan = read_header(path).plan
            self.rows += [row | {"plan": plan, "path": path} for row in read_quality(path)]

    def lively(self, count: int, clips: Collection[str] | None = None) -> list[dict]:
        """Sequences of different labels with the base parameters, the liveliest first, of the given clips only."""
        mine = [r for r in self.rows if r["plan"] == MOTIONS and (clips is None or r["clip"] in clips)]
        mine = sorted(mine, key=lambda r: _rank(str(r["label"])))
        first = {r["label"]: r for r in reversed(mine)}
        different = [r for r in mine if first[r["label"]] is r]
        rest = [r for r in mine if first[r["label"]] is not r]
        return (different + rest)[:count]

    def materials(self) -> list[dict]:
        """Parameter sets of one clip that differ most in what an eye can tell, softest first; fewer than 3: none."""
        by_clip: dict[str, list[dict]] = {}
        for row in self.rows:
            if row["plan"] == MATERIALS:
                by_clip.setdefault(str(row["clip"]), []).append(row)
        order = sorted(by_clip, key=lambda c: (-len(by_clip[c]), _rank(str(by_clip[c][0]["label"]))))
        mine = by_clip[order[0]] if order else []
        if len(mine) < MATERIAL_SETS:
            return []
        values = np.log([[max(float(r[f"parameter_{n}"]), 1e-9) for n in SEEN_MATERIALS] for r in mine])
        values = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-9)
        distance = np.linalg.norm(values[:, None] - values[None], axis=2)
        chosen = list(np.unravel_index(distance.argmax(), distance.shape))
        while len(chosen) < MATERIAL_SETS:
            chosen.append(int(distance[chosen].min(axis=0).argmax()))
        return sorted((mine[i] for i in chosen), key=lambda r: float(r["parameter_bend"]))

    def read(self, rows: Many[Mapping]) -> list[Sequence]:
        """The sequences of the rows, in their order."""
        wanted = {(r["path"], r["clip"], r["phi"]): i for i, r in enumerate(rows)}
        found: dict[int, Sequence] = {}
        for path in dict.fromkeys(r["path"] for r in rows):
            for sequence in load_sequences([path], self.rule):
                place = wanted.get((path, sequence.clip, sequence.phi))
                if place is not None:
                    found[place] = sequence
        return [found[i] for i in sorted(found)]


def say(job: Job, what: str) -> None:
    """A line of progress."""
    print(f"[render {job.spec['garment']}] {what}", flush=True)


def _rank(label: str) -> int:
    """Place of a label in ``LIVELY``; all others come after, as equals."""
    return LIVELY.index(label) if label in LIVELY else len(LIVELY)


def _clip_words(row: Mapping) -> str:
    strain = (
        f", 99% of edges within {100 * float(row['p99_edge_strain']):.0f}% strain" if "p99_edge_strain" in row else ""
    )
    return f"Clip {row['clip']}, base material{strain}."


def _material_words(row: Mapping) -> str:
    bend, density = float(row["parameter_bend"]), float(row["parameter_density"])
    stretch, drag = float(row["parameter_stretch"]), float(row["parameter_air_drag"])
    return f"bend {1e6 * bend:.0f} µN m, {1e3 * density:.0f} g/m², stretch {stretch:.0f} N/m, drag {drag:.1f} N s/m³"


if __name__ == "__main__":
    run_stage(main)

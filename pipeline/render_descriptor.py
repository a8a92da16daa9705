"""Stage ``render_descriptor``: what the shape descriptor does to a garment, in pictures (Wang 2019, Fig. 6, 8 and 9).

In: the template, the folder of the curve, the descriptor in use and all shards of a garment. Out: a folder of pictures
with their list ``figures.json``: a held-out frame through the descriptor with and without the Laplacian term and
through principal components, with error maps; shapes between two parameter sets; what becomes of implausible shapes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from body.model import Body
from datasets.atomic import atomic_folder
from datasets.sequences import Sequence, from_canonical, to_canonical
from datasets.splits import TRAIN
from evaluation.descriptor import interpolate_shapes
from evaluation.descriptor_shapes import PLAUSIBLE, NearestFrames, implausible_shapes
from evaluation.metrics import edge_strain
from garments.template import GarmentTemplate
from models.pca import fit_pca
from models.plausible_codes import PlausibleCodes
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all, load_shape_descriptor
from pipeline.sequence_data import canonical_frames, job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.train_descriptor_curve import NO_LAPLACIAN
from report.gallery import Gallery, round_scale
from report.render import ERROR_STOPS, worn_colours
from report.sheets import with_legend

MOST_FRAMES = 4000
"""Training frames that principal components and nearest frames are taken from; neighbouring frames are alike."""
STEPS = 5
"""Shapes of an interpolation, its ends among them."""

Through = Callable[[np.ndarray], np.ndarray]
"""Frames [N, V, 3] to frames."""


def main(job: Job) -> None:
    """Draw everything into a folder beside the final one, then move it there."""
    torch.set_num_threads(max(1, job.threads))
    with atomic_folder(job.outputs[0]) as folder:
        draw(job, folder)


def draw(job: Job, folder: Path) -> None:
    """All pictures, in the order of the page."""
    spec, settings = job.spec, job.spec["report"]
    template_path, curve, model, *shards = job.inputs
    body, template = job_body(job), GarmentTemplate.load(template_path)
    module = load_shape_descriptor(model, template.faces)
    plain = load_shape_descriptor(Path(curve) / f"{NO_LAPLACIAN}.pt", template.faces)
    sequences = job_sequences(job, shards)
    training = canonical_frames([s for s in sequences if s.split == TRAIN], body)
    training = training[:: -(-len(training) // MOST_FRAMES)]
    held_out = [s for s in sequences if s.split != TRAIN]
    if not held_out or len(training) <= module.config.code:
        raise ValueError(f"{spec['garment']}: too few simulated sequences to draw the shape descriptor")
    pca = fit_pca(training.reshape(len(training), -1), module.config.code, spec["seed"])

    def linear(frames: np.ndarray) -> np.ndarray:
        return pca.decode(pca.encode(frames.reshape(len(frames), -1))).reshape(frames.shape)

    size = (settings["width"], settings["height"])
    colours = worn_colours(template.worn_as, template.layer)
    gallery = Gallery(folder, spec["garment"], colours, template.faces, body.faces, size, 1.0)
    nearest = NearestFrames(training)
    draw_errors(gallery, held_out, body, through(module), through(plain), linear)
    absent = []
    if not draw_between(gallery, held_out, body, module, template):
        absent.append("no held-out clip was simulated under two parameter sets, so no shape between two is shown")
    plausible = PlausibleCodes.of(encode_all(module, training))

    def mended(frames: np.ndarray) -> np.ndarray:
        return decode_all(module, plausible.nearest(encode_all(module, frames)))

    draw_implausible(gallery, held_out, body, template, through(module), mended, linear, nearest, spec["seed"])
    gallery.write(absent=absent)


def through(module: ShapeDescriptor) -> Through:
    """Into the descriptor and back."""
    return lambda frames: decode_all(module, encode_all(module, frames))


def draw_errors(
    gallery: Gallery, sequences: list[Sequence], body: Body, ours: Through, plain: Through, linear: Through
) -> None:
    """Fig. 6: the held-out frame with the median error, through each method, with error maps of one scale."""
    rest = [s.frames // 2 for s in sequences]
    truth = np.concatenate([_canonical(s, t, body) for s, t in zip(sequences, rest, strict=True)])
    order = np.argsort(_distance(ours(truth), truth).mean(axis=1))
    k = int(order[len(order) // 2])
    sequence, frame, one = sequences[k], rest[k], truth[k : k + 1]
    results = [one, ours(one), plain(one), linear(one)]
    errors = [_distance(result, one)[0] for result in results]
    largest = round_scale(float(np.percentile(errors[-1], 98)))
    shapes, maps = [], []
    for result, error in zip(results, errors, strict=True):
        shapes.append(_still(gallery, result[0], sequence, frame, body))
        map_ = _still(gallery, result[0], sequence, frame, body, error=error, largest_error=largest)
        maps.append(with_legend(map_[None], ERROR_STOPS, 1e3 * largest, "mm", "error")[0])
    rms = [1e3 * float(np.sqrt(np.mean(error**2))) for error in errors]
    gallery.sheet(
        "descriptor_error",
        [shapes, maps],
        ["shape", "error"],
        ["simulated", "descriptor", "no Laplacian term", "PCA"],
        f"Frame {frame} of {sequence.clip}, not trained on, the median of the held-out sequences. RMSE: descriptor "
        f"{rms[1]:.1f} mm, without the Laplacian term {rms[2]:.1f} mm, principal components {rms[3]:.1f} mm.",
        "A frame and its reconstructions with error maps",
        rmse_mm=rms[1], no_laplacian_rmse_mm=rms[2], pca_rmse_mm=rms[3],
    )  # fmt: skip


def draw_between(
    gallery: Gallery, sequences: list[Sequence], body: Body, module: ShapeDescriptor, template: GarmentTemplate
) -> bool:
    """Fig. 8: between the two held-out parameter sets that are farthest apart in a clip; False where there are none."""
    by_clip: dict[str, list[Sequence]] = {}
    for sequence in sequences:
        by_clip.setdefault(sequence.clip, []).append(sequence)
    pairs = [pair for several in by_clip.values() for pair in itertools.combinations(several, 2)]
    if not pairs:
        return False
    # Within a clip all see the same motion; a few frames tell how far apart two sequences are.
    apart = [_distance(a.vertices[::10], b.vertices[::10]).mean(axis=1) for a, b in pairs]
    k = max(range(len(pairs)), key=lambda i: apart[i].max())
    (first, second), frame = pairs[k], 10 * int(apart[k].argmax())
    a, b = _canonical(first, frame, body)[0], _canonical(second, frame, body)[0]
    shares = np.linspace(0.0, 1.0, STEPS)
    learned = interpolate_shapes(module, a, b, STEPS)
    straight = np.stack([(1 - s) * a + s * b for s in shares]).astype(np.float32)
    strain = [
        100 * edge_strain(path[1:-1], template.vertices, template.topology.edges).p99 for path in (learned, straight)
    ]
    learned[0], learned[-1] = a, b
    rows = [[_still(gallery, shape, first, frame, body) for shape in path] for path in (learned, straight)]
    names = [f"set {first.phi}", *(f"{100 * s:.0f}%" for s in shares[1:-1]), f"set {second.phi}"]
    gallery.sheet(
        "descriptor_between",
        rows,
        ["descriptor", "straight"],
        names,
        f"Frame {frame} of {first.clip}, simulated under two parameter sets (left and right), and shapes between them: "
        f"by the descriptor, 99% of edges within {strain[0]:.0f}% strain, and by a straight way of each vertex, "
        f"{strain[1]:.0f}%.",
        "Shapes between two simulated ones",
        p99_strain_percent=strain[0], straight_p99_strain_percent=strain[1],
    )  # fmt: skip
    return True


def draw_implausible(
    gallery: Gallery,
    sequences: list[Sequence],
    body: Body,
    template: GarmentTemplate,
    ours: Through,
    mended: Through,
    linear: Through,
    nearest: NearestFrames,
    seed: int,
) -> None:
    """Fig. 9: shapes that cloth cannot have, and what each method makes of them."""
    chosen = sequences[:: max(1, len(sequences) // 2)][:2]
    frames = np.concatenate([_canonical(s, s.frames // 2, body) for s in chosen])
    sequence = chosen[0]
    rows, names, words = [], [], []
    for name, shapes in implausible_shapes(frames, template.vertices, seed).items():
        one = shapes[:1]
        results = [one, ours(one), mended(one), linear(one), nearest.nearest(one)[0]]
        rows.append([_still(gallery, r[0], sequence, sequence.frames // 2, body) for r in results])
        strain = [100 * edge_strain(r, template.vertices, template.topology.edges).p99 for r in results]
        names.append(name)
        words.append(f"{name} {strain[0]:.0f}% → {strain[1]:.0f}% → {strain[2]:.0f}% (PCA {strain[3]:.0f}%)")
    gallery.sheet(
        "descriptor_implausible",
        rows,
        names,
        ["as given", "descriptor", PLAUSIBLE, "PCA", "nearest frame"],
        "99th percentile of the edge strain, as given, through the descriptor, and through it with the code moved to "
        f"the nearest one that the training holds plausible: {'; '.join(words)}. On the right the nearest training "
        "frame.",
        "Implausible shapes and what each method makes of them",
    )


def _still(gallery: Gallery, shape: np.ndarray, sequence: Sequence, frame: int, body: Body, **drawing) -> np.ndarray:
    """A canonical shape [V, 3] on the body of a frame."""
    pose, root = sequence.pose[frame : frame + 1], sequence.root[frame : frame + 1]
    world = from_canonical(shape[None], pose, root, body)[0]
    return gallery.still(world, body.posed(pose, root)[0], **drawing)


def _canonical(sequence: Sequence, frame: int, body: Body) -> np.ndarray:
    one = slice(frame, frame + 1)
    return to_canonical(sequence.vertices[one], sequence.pose[one], sequence.root[one], body)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1)


if __name__ == "__main__":
    run_stage(main)

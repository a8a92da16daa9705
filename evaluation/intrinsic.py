"""Does z hold the material and not the motion? (Wang 2019, section 4 (ii), Fig. 10 and 11, with the controls it lacks.)

In: a trained motion-invariant network, the shape descriptor below it, and frames with their simulated garments in the
canonical frame. Out: rows of transfer errors against the simulation and of the latent's variance ratio. A sequence is
the run of frames with one phi and one clip; its z is that of all its frames together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from evaluation.metrics import rmse
from evaluation.table import Row
from models.intrinsic_fitting import frame_evidence, pooled
from models.motion_invariant import MotionInvariantNetwork
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, decode_all


@dataclass(frozen=True)
class ReadFrames:
    """Frames with what a network says of z in each of them, which is computed once, whatever is asked of them.

    Attributes:
        network: In eval mode.
        frames: N of them, in time order within a sequence.
        values, weights: ``frame_evidence`` of the frames, shape [N, Z] each.
    """

    network: MotionInvariantNetwork
    frames: IntrinsicFrames
    values: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, network: MotionInvariantNetwork, frames: IntrinsicFrames) -> ReadFrames:
        """Read all frames."""
        return cls(network, frames, *frame_evidence(network, frames))

    def at(self, index: np.ndarray) -> ReadFrames:
        """The frames of the given numbers."""
        return ReadFrames(self.network, self.frames.at(index), self.values[index], self.weights[index])

    def latent(self, index: np.ndarray) -> np.ndarray:
        """The z [Z] of the frames of the given numbers together."""
        return pooled(self.network, self.values[index], self.weights[index])

    def single_latents(self) -> np.ndarray:
        """The z [N, Z] of each frame alone."""
        return pooled(self.network, self.values[None], self.weights[None])

    @torch.no_grad()
    def decoded(self, latents: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Descriptors [N, C] of the frames' motion with each z, one for all frames [Z] or one for each [N, Z].

        What the network makes of the motion is the same for all of them and computed once.
        """
        context = self.network.context(torch.from_numpy(self.frames.signatures[:]))
        each = {name: np.broadcast_to(z, (len(self.values), z.shape[-1])) for name, z in latents.items()}
        return {name: self.network.decode(torch.from_numpy(z.copy()), context).numpy() for name, z in each.items()}

    def sequence_latents(self) -> tuple[np.ndarray, np.ndarray]:
        """The z of each sequence [S, Z], and its phi [S]."""
        runs = sequences_of(self.frames)
        return np.stack([self.latent(index) for index in runs.values()]), np.array([phi for phi, _ in runs])


def transfer_rows(
    descriptor: ShapeDescriptor,
    test: ReadFrames,
    vertices: np.ndarray,
    training: ReadFrames,
    split: str,
    sources: ReadFrames | None = None,
    seed: int = 0,
    stride: int = 1,
) -> list[Row]:
    """Errors of decoding each sequence's motion with a z from elsewhere, against its own simulation.

    Args:
        descriptor: The frozen shape descriptor that made the frames' descriptors.
        test: Test frames, read by the network that is evaluated.
        vertices: Their simulated garments [m], shape [N, V, 3].
        training: The network's training frames: the mean z and the mean shape of the controls come from them.
        split: Name for the rows.
        sources: Frames that z may be taken from where the split holds a phi with one clip only (default: ``test``).
        seed: Of the choice of single frames, source clips and wrong phi.
        stride: Frames from one measured frame of a sequence to the next; z is always taken from all.

    Returns:
        Rows with ``rmse_mm`` (root mean square over vertices and frames of a sequence, mean over sequences):
        "descriptor floor" (encoded and decoded without this network), "own reconstruction", "transfer, z of a clip"
        (of another clip of the same phi), "transfer, z of one frame" (of that clip), "transfer, z of all other clips",
        "wrong phi, z of a clip" (the same clip under another phi, where there is one), "mean z" (one z for all),
        "mean shape" (the decoded mean descriptor).

    Raises:
        ValueError: no sequence has a second clip with its phi, or shapes disagree.
    """
    frames = test.frames
    if len(vertices) != len(frames.descriptors):
        raise ValueError(f"transfer: {len(frames.descriptors)} frames, but {len(vertices)} garments")
    sources = test if sources is None else sources
    generator = np.random.default_rng(seed)
    runs = sequences_of(sources.frames)
    mean_latent = training.sequence_latents()[0].mean(axis=0)
    mean_descriptor = training.frames.descriptors.mean(axis=0, keepdims=True)
    errors: dict[str, list[float]] = {}

    for (phi, clip), index in sequences_of(frames).items():
        others = [key for key in runs if key[0] == phi and key[1] != clip]
        if not others:
            continue
        source = runs[others[generator.integers(len(others))]]
        wrong = _wrong_phi(runs, phi, sources.frames.clip[source[0]], generator)
        measured = index[::stride]
        truth, seen = vertices[measured], test.at(measured)
        latents: dict[str, np.ndarray] = {
            "own reconstruction": seen.single_latents(),
            "transfer, z of a clip": sources.latent(source),
            "transfer, z of one frame": sources.latent(generator.choice(source, 1)),
            "transfer, z of all other clips": sources.latent(np.concatenate([runs[key] for key in others])),
        }
        if wrong is not None:
            latents["wrong phi, z of a clip"] = sources.latent(wrong)
        latents["mean z"] = mean_latent
        predictions = {"descriptor floor": seen.frames.descriptors, **seen.decoded(latents)}
        predictions["mean shape"] = np.repeat(mean_descriptor, len(measured), axis=0)
        names, codes = list(predictions), np.concatenate(list(predictions.values()))
        for name, decoded in zip(names, np.split(decode_all(descriptor, codes), len(names)), strict=True):
            errors.setdefault(name, []).append(rmse(decoded, truth))
    if not errors:
        raise ValueError(f"transfer, split {split}: no parameter set has two clips, so there is nothing to transfer")
    return [
        {"split": split, "quantity": name, "rmse_mm": 1e3 * float(np.mean(values)), "sequences": len(values)}
        for name, values in errors.items()
    ]


def variance_row(test: ReadFrames, split: str) -> Row:
    """Variance of z within one phi over the variance of its means across phi; 0 = motion-invariant.

    ``ratio`` is of single frames, as is the variance in the paper's loss (section 3.4; the paper prints no figure), and
    the harder one: a frame tells little of some materials. ``clip_ratio`` is of the z of each sequence. None with fewer
    than two phi, or where z does not vary at all.
    """
    (latents, owners), phi = test.sequence_latents(), np.asarray(test.frames.phi)
    return {
        "split": split,
        "phi_count": len(np.unique(phi)),
        "ratio": variance_ratio(test.single_latents(), phi),
        "clip_ratio": variance_ratio(latents, owners),
    }


def variance_ratio(latents: np.ndarray, phi: np.ndarray) -> float | None:
    """Mean variance within a phi over the variance of the phi's means, both summed over the numbers of z [N, Z]."""
    values = np.unique(phi)
    if len(values) < 2:
        return None
    within = np.mean([latents[phi == value].var(axis=0).sum() for value in values])
    across = np.stack([latents[phi == value].mean(axis=0) for value in values]).var(axis=0).sum()
    return float(within / across) if across > 1e-12 else None


def against_controls(rows: list[Row]) -> list[Row]:
    """The transfers of all variants, each beside the same transfer of the two controls.

    ``over_true_parameters`` is the error over that of the decoder that is given the true parameters; ``gain_share`` the
    share of that decoder's gain over motion alone that is reached: 1 as good, 0 no better than no z, below 0 worse.
    Without both controls, and in other rows, they stay out.
    """
    known = {(r["variant"], r["split"], r["quantity"]): r["rmse_mm"] for r in rows}
    out = []
    for row in rows:
        motion = known.get(("motion-only", row["split"], row["quantity"]))
        true = known.get(("true-parameters", row["split"], row["quantity"]))
        if str(row["quantity"]).startswith("transfer") and motion is not None and true is not None:
            row = row | {"over_true_parameters": row["rmse_mm"] / true}
            if motion > true:
                row = row | {"gain_share": (motion - row["rmse_mm"]) / (motion - true)}
        out.append(row)
    return out


def sequences_of(frames: IntrinsicFrames) -> dict[tuple[int, int], np.ndarray]:
    """Frame numbers of each (phi, clip), in the order of the data."""
    keys = np.stack([np.asarray(frames.phi), np.asarray(frames.clip)], axis=1)
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    order = np.argsort(inverse, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(inverse))[:-1])
    return {(int(p), int(c)): part for (p, c), part in zip(unique, parts, strict=True)}


def _wrong_phi(
    runs: Mapping[tuple[int, int], np.ndarray], phi: int, clip: int, generator: np.random.Generator
) -> np.ndarray | None:
    """A sequence of the source's clip under another phi; of any clip where that clip has no other."""
    strangers = [key for key in runs if key[0] != phi]
    same_clip = [key for key in strangers if key[1] == clip]
    chosen = same_clip or strangers
    return runs[chosen[generator.integers(len(chosen))]] if chosen else None

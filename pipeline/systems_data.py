"""The four systems as predictors of one garment's vertices, each given what it may fairly be given.

- Shi 2023: the motion. The ``conditioned`` regressor is told the material too.
- Wang 2019: the motion, and the z of the material: the mean over other simulations of the same garment in the same
  material, of which none is a test frame. For the base material these are its training clips, for a material that was
  held out its simulations on clips that were trained on.
- Peng 2023: the motion, the material, and the template, which it never saw in training: it learned on the wardrobe.
- Ma 2019: the pose and the type of clothing, no material, and no motion: z is zero, the middle of what it draws. It
  says how far the body's vertices are moved; the garment's own follow from these (``garments.layer_wearing``).
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Many
from dataclasses import replace

import numpy as np
import torch
from torch import nn

from body.model import Body
from datasets.codes import CodedSequence
from datasets.sequences import Sequence
from datasets.shards import MOTIONS, read_header
from datasets.splits import TRAIN, UNSEEN_PARAMETERS
from evaluation.regressor import Predictor
from garments.body_layer import BodyLayer, LayerMap, cast_layer, dressed_body
from garments.layer_wearing import LayerWearing
from garments.template import GarmentTemplate
from models.garment_animator import Animator, Motion
from models.garment_graph import GarmentGraph, material_row
from models.intrinsic_fitting import frame_evidence, pooled
from models.mesh_vae_gan import MeshVaeGan
from models.motion_features import sequence_track
from models.motion_invariant import MotionInvariantNetwork
from models.shape_descriptor import ShapeDescriptor
from pipeline.garment_predictors import autoencoder_predictor
from pipeline.intrinsic_data import all_codes, intrinsic_frames

RESIDUAL_CLIPS, RESIDUAL_STRIDE = 24, 6
"""Training clips, evenly spread, and frames of each that tell a mean residual."""

LATENT_FRAMES = 2000
"""Frames, evenly spread, that tell the z of a material."""


def material_predictor(
    network: MotionInvariantNetwork, descriptor: ShapeDescriptor, coded: Many[CodedSequence], names: tuple[str, ...]
) -> Predictor:
    """Wang's decoder along a motion, with the z of the sequence's material.

    Args:
        network: The autoencoder.
        descriptor: The shape descriptor below it.
        coded: Simulations that z may be taken from. A material with none of them: the predictor has nothing to say.
        names: Parameters that the network may be told, those that vary in its training.
    """
    made: dict[int, Predictor | None] = {}

    def of_material(phi: int) -> Predictor | None:
        mine = [s for s in coded if s.phi == phi]
        if not mine:
            return None
        codes = all_codes(mine)
        rows = np.unique(np.linspace(0, len(codes) - 1, min(LATENT_FRAMES, len(codes))).astype(int))
        frames = intrinsic_frames(mine, codes, network.config, names).at(rows)
        return autoencoder_predictor(network, descriptor, pooled(network, *frame_evidence(network, frames)))

    def predict(sequence: Sequence) -> np.ndarray | None:
        if sequence.phi not in made:
            made[sequence.phi] = of_material(sequence.phi)
        decode = made[sequence.phi]
        return None if decode is None else decode(sequence)

    return predict


def animator_predictor(animator: Animator, template: GarmentTemplate, body: Body) -> Predictor:
    """GSNet on a template; it is encoded once a material.

    Raises:
        ValueError: The template sits on another body than the network was trained on.
    """
    if animator.config.body != body.digest:
        raise ValueError(f"{animator.kind}: trained on body {animator.config.body}, asked for body {body.digest}")
    graph, encodings = GarmentGraph.of(template, body), {}

    @torch.no_grad()
    def predict(sequence: Sequence) -> np.ndarray:
        row = material_row(sequence.parameters, animator.config.materials)
        key = row.tobytes()
        if key not in encodings:
            encodings[key] = animator.encode(graph, torch.as_tensor(row)[None])
        vertices = animator.unroll(encodings[key], Motion.of([sequence_track(sequence)], body))[0]
        return sequence.in_world(vertices.numpy())

    return predict


class WornLayer:
    """The Mesh VAE-GAN's layer of one type of clothing as a garment of the run.

    Args:
        network: Trained on outfits.
        body: The body.
        kind: Type of clothing.
        wearing: The garment's points over the body vertices that the type's outer garment covers.
        residual: Added to what the network says of them in the unposed space [m], shape [C, 3].
    """

    def __init__(
        self,
        network: MeshVaeGan,
        body: Body,
        kind: str,
        wearing: LayerWearing,
        residual: np.ndarray | float = 0.0,
    ) -> None:
        self.network, self.body, self.kind, self.wearing = network, body, kind, wearing
        self.active, self.residual = network.hierarchy.levels[0], residual

    def with_mean_residual(self, training: Many[Sequence]) -> WornLayer:
        """With the mean of what the true layer of the garment's own clips has over zero z.

        It learned on outfits of another cut and fabric, and cannot be told of these: what that costs is told apart.
        """
        chosen = np.unique(np.arange(RESIDUAL_CLIPS) * len(training) // RESIDUAL_CLIPS)
        left = []
        for sequence in (training[i] for i in chosen):
            some = replace(
                sequence, **{n: getattr(sequence, n)[::RESIDUAL_STRIDE] for n in ("vertices", "pose", "root", "joints")}
            )
            true = self._true(some)
            if true is not None:
                left.append(true - self._generated(some)[:, self.wearing.layer.covered])
        if not left:
            raise ValueError(f"garment '{self.wearing.template.name}': no training clip is a layer of the body")
        return WornLayer(self.network, self.body, self.kind, self.wearing, np.concatenate(left).mean(axis=0))

    def points(self, sequence: Sequence) -> np.ndarray:
        """The points over the body [m], [T, C, 3], that zero z, pose and type say."""
        return self._worn(self._generated(sequence), sequence)

    def predict(self, sequence: Sequence) -> np.ndarray:
        """The garment [m], [T, V, 3], at these points."""
        return self.wearing.garment(self.points(sequence), sequence.pose, sequence.root)

    def reconstructed_points(self, sequence: Sequence) -> np.ndarray | None:
        """The true points through the encoder and back; what the garment does not cover is as with zero z.

        None where a joint is twisted so far that its skinning cannot be undone.
        """
        true = self._true(sequence)
        if true is None:
            return None
        whole = self._generated(sequence)
        whole[:, self.wearing.layer.covered] = true
        back = np.zeros_like(whole)
        back[:, self.active] = self.network.reconstruct(
            whole[:, self.active], sequence.pose, [self.kind] * sequence.frames
        )
        return self._worn(back, sequence)

    def reconstructed(self, sequence: Sequence) -> np.ndarray | None:
        """The garment [m], [T, V, 3], of the true layer through the encoder and back."""
        points = self.reconstructed_points(sequence)
        return None if points is None else self.wearing.garment(points, sequence.pose, sequence.root)

    def _true(self, sequence: Sequence) -> np.ndarray | None:
        """The simulated garment's layer in the unposed space [m], [T, C, 3]."""
        layer = BodyLayer(self.wearing.layer, self.body)
        try:
            return layer.displacements(sequence.vertices, sequence.pose, sequence.root)
        except ValueError as error:
            print(f"[compare systems] {sequence.clip} has no layer: {error}", flush=True)
            return None

    def _generated(self, sequence: Sequence) -> np.ndarray:
        z = np.zeros((sequence.frames, self.network.config.latent))
        whole = self.network.generate(z, sequence.pose, [self.kind] * sequence.frames)
        whole[:, self.wearing.layer.covered] += self.residual
        return whole

    def _worn(self, whole: np.ndarray, sequence: Sequence) -> np.ndarray:
        return dressed_body(self.body, whole, sequence.pose, sequence.root)[:, self.wearing.layer.covered]


def nearest_type(garment: LayerMap, outfits: dict[str, GarmentTemplate], body: Body) -> tuple[str, np.ndarray]:
    """The type of clothing whose outer garment covers most nearly what a garment covers, and where both do, [C]."""
    best: tuple[float, str, np.ndarray] = (-1.0, "", np.zeros(0, dtype=int))
    for kind, template in outfits.items():
        layer = cast_layer(template, body)
        outer = layer.covered[layer.worn == layer.worn.max()]
        both = np.intersect1d(outer, garment.covered)
        share = len(both) / len(np.union1d(outer, garment.covered))
        if share > best[0]:
            best = (share, kind, both)
    return best[1], best[2]


def sizes(*modules: nn.Module) -> dict[str, int]:
    """Trained parameters of networks and all numbers that they keep, without a judge's that training alone needs."""
    made = {"parameters": 0, "stored_numbers": 0}
    for module in modules:
        judge = "discriminator"
        made["parameters"] += sum(p.numel() for n, p in module.named_parameters() if not n.startswith(judge))
        made["stored_numbers"] += sum(v.numel() for n, v in module.state_dict().items() if not n.startswith(judge))
    return made


def check_shards(paths: Iterable[str], template: GarmentTemplate) -> None:
    """``ValueError`` in one sentence where a shard is not of the template, or not on its body."""
    for path in paths:
        header = read_header(path)
        same = np.array_equal(header.template_vertices, template.vertices)
        same = same and np.array_equal(header.template_faces, template.faces)
        if header.garment != template.name or header.body_digest != template.body_digest or not same:
            raise ValueError(
                f"{path}: simulations of garment '{header.garment}' on body {header.body_digest}, expected those "
                f"of the template '{template.name}' on body {template.body_digest}; make both again"
            )


def z_sources(coded: Many[CodedSequence]) -> list[CodedSequence]:
    """Simulations that z is taken from: training clips in the base material; held-out materials on clips trained on."""
    return [s for s in coded if (s.plan == MOTIONS and s.split == TRAIN) or s.split == UNSEEN_PARAMETERS]

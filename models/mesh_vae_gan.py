"""Conditional Mesh VAE-GAN: clothing as a layer of displacements on the body mesh (Ma 2019).

In: displacements of the body's vertices in the unposed space [m], pose, type of clothing. Out: the layer again through
a short code z, or new layers from random z. Encoder and generator are blocks of Chebyshev convolutions with quadric
down- and up-sampling and a dense layer to and from z; pose and type reach the generator and the discriminator through
small dense networks; the discriminator judges patches of the mesh.

Kinds of one code:

- ``paper``: the published network.
- ``coma``: its predecessor, a mesh autoencoder without condition, shortcuts, discriminator, normals and latent noise
  (Ranjan 2018). The paper calls it CoMA-1 without down-sampling and CoMA-4 with a fourfold one at each layer.
- ``anchored``: ours. What pose and type alone say of the layer is a ridge regression, and each type's principal
  components of what that leaves over *on clips it was not fitted to* are the first meaning of z: a type of clothing
  wrinkles in its own way and needs no component for another's sleeves. The types' components are turned onto each
  other, so that one z means much the same for all of them. The networks start from there with a last layer of zeros
  and learn what is not linear. z has unit variance from the first step on, so that a random z is a likely one.

A Active vertices (those that any type covers), B body vertices, N frames, L length of z, K types.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from geometry.mesh_hierarchy import MeshHierarchy
from geometry.rotations import axis_angle_to_6d, axis_angle_to_matrix
from models.layer_losses import unit_face_normals
from models.mesh_convolution import SparseOperator, scaled_laplacian
from models.mesh_vae_gan_blocks import Condition, Discriminator, Encoder, Generator, flat, unflat
from models.mesh_vae_gan_config import POSES, MeshVaeGanConfig


class MeshVaeGan(nn.Module):
    """The network; ``models.mesh_vae_gan_fitting`` trains, stores and loads it.

    Args:
        config: Sizes.
        hierarchy: Levels of the body mesh over the active vertices.
        rest: Active vertices of the run's own body in the unposed space [m], shape [A, 3]: face normals are those of
            the clothed mesh.
    """

    def __init__(self, config: MeshVaeGanConfig, hierarchy: MeshHierarchy, rest: np.ndarray) -> None:
        super().__init__()
        self.config, self.hierarchy = config, hierarchy
        count = len(hierarchy.levels[0])
        deepest = max(config.levels + (config.discriminator_levels if config.discriminator != "none" else ()))
        if deepest >= len(hierarchy.levels):
            raise ValueError(f"mesh VAE-GAN levels: {deepest} is asked for, there are 0..{len(hierarchy.levels) - 1}")
        features = POSES[config.pose]
        code = config.pose_code + config.type_code if config.conditional else 0
        laplacians: dict[int, SparseOperator] = {}

        def laplacian(level: int) -> SparseOperator:
            if level not in laplacians:
                laplacians[level] = SparseOperator(scaled_laplacian(hierarchy.adjacency(level)))
            return laplacians[level]

        if config.conditional:
            self.condition = Condition(features, len(config.types), config)
        self.encoder = Encoder(config, hierarchy, laplacian)
        self.generator = Generator(config, hierarchy, laplacian, config.latent + code)
        if config.discriminator != "none":
            self.discriminator = Discriminator(config, hierarchy, laplacian, code)
        self.register_buffer("rest", torch.as_tensor(np.asarray(rest, dtype=np.float32)))
        self.register_buffer("faces", torch.as_tensor(hierarchy.faces[0].astype(np.int64)))
        self.register_buffer("mean", torch.zeros(count, 3))
        self.register_buffer("scale", torch.ones(()))
        self.register_buffer("pose_mean", torch.zeros(features))
        self.register_buffer("pose_spread", torch.ones(features))
        if config.kind == "anchored":
            inputs = len(config.types) * (features + 1)
            self.register_buffer("regression", torch.zeros(inputs, config.components))
            self.register_buffer("directions", torch.zeros(config.components, count * 3))
            self.register_buffer("bases", torch.zeros(len(config.types), config.latent, count * 3))
            self.register_buffer("inverses", torch.zeros(len(config.types), config.latent, config.latent))

    def posed_features(self, pose: np.ndarray) -> Tensor:
        """Standardised features [N, P] of poses [N, 24, 3] [rad]."""
        raw = torch.as_tensor(pose_features(pose, self.config.pose), device=self.rest.device)
        return (raw - self.pose_mean) / self.pose_spread

    def type_weights(self, types: Sequence[str]) -> Tensor:
        """One-hot vectors [N, number of types]; ``ValueError`` for an unknown type lists the known."""
        known = {name: number for number, name in enumerate(self.config.types)}
        for name in types:
            if name not in known:
                raise ValueError(f"unknown type of clothing {name!r}; this network knows {', '.join(known)}")
        rows = torch.tensor([known[name] for name in types], device=self.rest.device)
        return nn.functional.one_hot(rows, len(known)).float()

    def scaled(self, displacements: Tensor) -> Tensor:
        """Network units [A, N, 3] of displacements [N, A, 3] [m]."""
        return ((displacements - self.mean) / self.scale).transpose(0, 1)

    def unscaled(self, features: Tensor) -> Tensor:
        """Displacements [N, A, 3] [m] of network units [A, N, 3]."""
        return features.transpose(0, 1) * self.scale + self.mean

    def encode(self, features: Tensor, pose: Tensor, types: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance [N, L] of z for features [A, N, 3] in network units."""
        if self.config.kind != "anchored":
            return self.encoder(features)
        rest = flat(features) - self._regressed(pose, types)
        mean, spread = self.encoder(unflat(rest, features))
        return self._linear_code(rest, types) + mean, spread

    def decode(self, z: Tensor, pose: Tensor, types: Tensor) -> Tensor:
        """Features [A, N, 3] in network units of codes z [N, L], standardised pose [N, P] and type weights."""
        code = z
        if self.config.conditional:
            code = torch.cat([z, self.condition(pose, types)], dim=1)
        learned = self.generator(code)
        if self.config.kind != "anchored":
            return learned
        own = (types[:, :, None] * z[:, None, :]).flatten(1)  # z in the rows of the frame's type, between two in both
        linear = self._regressed(pose, types) + own @ self.bases.flatten(0, 1)
        return unflat(linear, learned) + learned

    def verdict(self, features: Tensor, pose: Tensor, types: Tensor) -> Tensor:
        """The discriminator's logits, patches by frames, of features [A, N, 3]; positive = real."""
        code = self.condition(pose, types).detach() if self.config.conditional else None
        return self.discriminator(features, code)

    def normals(self, features: Tensor) -> Tensor:
        """Unit face normals [F, N, 3] of the clothed mesh in the unposed space."""
        worn = features * self.scale + (self.mean + self.rest)[:, None]
        return unit_face_normals(worn, self.faces)

    def _linear_code(self, rest: Tensor, types: Tensor) -> Tensor:
        """z [N, L] whose combination of its type's basis is nearest to what the regression leaves over, [N, 3 A]."""
        along = (rest @ self.bases.flatten(0, 1).T).unflatten(1, self.bases.shape[:2])
        return torch.einsum("nk,nkl,klm->nm", types, along, self.inverses)

    def _regressed(self, pose: Tensor, types: Tensor) -> Tensor:
        return (regression_inputs(pose, types) @ self.regression) @ self.directions

    @torch.no_grad()
    def reconstruct(self, displacements: np.ndarray, pose: np.ndarray, types: Sequence[str]) -> np.ndarray:
        """Displacements [N, A, 3] [m] through the mean code and back."""
        posed, weights = self.posed_features(pose), self.type_weights(types)
        found = np.empty(displacements.shape, dtype=np.float32)
        for rows in np.array_split(np.arange(len(displacements)), max(1, len(displacements) // 64)):
            features = self.scaled(torch.as_tensor(displacements[rows], device=self.rest.device))
            z, _ = self.encode(features, posed[rows], weights[rows])
            found[rows] = self.unscaled(self.decode(z, posed[rows], weights[rows])).cpu().numpy()
        return found

    @torch.no_grad()
    def generate(self, z: np.ndarray, pose: np.ndarray, types: Sequence[str] | np.ndarray) -> np.ndarray:
        """Layers of given codes.

        Args:
            z: Codes, standard normal for likely layers, shape [N, L].
            pose: Poses [rad], shape [N, 24, 3].
            types: Name of each frame's type, or weights of all types, shape [N, number of types]: between two types.

        Returns:
            Displacements of all body vertices in the unposed space [m], shape [N, B, 3] float32.

        Raises:
            ValueError: An unknown type, or shapes that do not go together.
        """
        if z.ndim != 2 or z.shape[1] != self.config.latent or len(z) != len(pose) or len(types) != len(z):
            raise ValueError(
                f"mesh VAE-GAN: expected z [N, {self.config.latent}] with N poses and types, got z {list(z.shape)}, "
                f"{len(pose)} poses, {len(types)} types"
            )
        device = self.rest.device
        given = isinstance(types, np.ndarray) and types.dtype.kind == "f"
        weights = torch.as_tensor(types.astype(np.float32), device=device) if given else self.type_weights(list(types))
        code = torch.as_tensor(z.astype(np.float32), device=device)
        layer = self.unscaled(self.decode(code, self.posed_features(pose), weights)).cpu().numpy()
        whole = np.zeros((len(z), self.body_vertices, 3), dtype=np.float32)
        whole[:, self.hierarchy.levels[0]] = layer
        return whole

    body_vertices: int = 0
    """Number of vertices of the whole body; set by whoever builds the network for one."""


def pose_features(pose: np.ndarray, kind: str) -> np.ndarray:
    """What the condition is told of poses [N, 24, 3] [rad], shape [N, ``POSES[kind]``] float32.

    Raises:
        ValueError: Poses of another shape.
    """
    pose = np.asarray(pose, dtype=np.float64)
    if pose.ndim != 3 or pose.shape[1:] != (24, 3):
        raise ValueError(f"pose: expected shape [N, 24, 3], got {list(pose.shape)}")
    if kind == "axis-angle":
        return pose.reshape(len(pose), -1).astype(np.float32)
    # The heading changes nothing about cloth; where down is does.
    down = axis_angle_to_matrix(pose[:, 0])[:, 1]
    return np.concatenate([axis_angle_to_6d(pose[:, 1:]).reshape(len(pose), -1), down], axis=1).astype(np.float32)


def regression_inputs(pose: Tensor, types: Tensor) -> Tensor:
    """A constant and the pose, of each type by its weight, shape [N, number of types * (P + 1)]."""
    one = torch.cat([torch.ones_like(pose[:, :1]), pose], dim=1)
    return (types[:, :, None] * one[:, None, :]).flatten(1)


def rebuilt_hierarchy(config: MeshVaeGanConfig, extra: Mapping[str, Tensor]) -> MeshHierarchy:
    """The hierarchy that ``hierarchy_tensors`` took apart."""
    import scipy.sparse as sp

    count = int(extra["level_count"])
    levels = tuple(extra[f"level_{k}"].numpy() for k in range(count))
    faces = tuple(extra[f"faces_{k}"].numpy() for k in range(count))
    up = []
    for k in range(count - 1):
        parts = tuple(extra[f"up_{k}_{name}"].numpy() for name in ("data", "indices", "indptr"))
        up.append(sp.csr_matrix(parts, shape=(len(levels[k]), len(levels[k + 1]))))
    return MeshHierarchy(config.body_digest, levels, faces, tuple(up))


def hierarchy_tensors(hierarchy: MeshHierarchy) -> dict[str, Tensor]:
    """A hierarchy as the tensors of a model file."""
    tensors = {"level_count": torch.tensor(len(hierarchy.levels))}
    for k, (level, faces) in enumerate(zip(hierarchy.levels, hierarchy.faces, strict=True)):
        tensors |= {f"level_{k}": torch.as_tensor(level), f"faces_{k}": torch.as_tensor(faces)}
    for k, matrix in enumerate(hierarchy.up):
        for name in ("data", "indices", "indptr"):
            tensors[f"up_{k}_{name}"] = torch.as_tensor(getattr(matrix, name))
    return tensors

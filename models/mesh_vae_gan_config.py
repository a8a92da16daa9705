"""Sizes and switches of the conditional Mesh VAE-GAN; ``models.mesh_vae_gan`` says what its kinds are (Ma 2019)."""

from __future__ import annotations

from dataclasses import dataclass

KINDS = ("paper", "anchored", "coma")
DISCRIMINATORS = ("patch", "global", "none")
POSES = {"axis-angle": 72, "6d": 141}


@dataclass(frozen=True)
class MeshVaeGanConfig:
    """Sizes and switches.

    Attributes:
        kind: One of ``KINDS``.
        types: Names of the types of clothing, in the order of their one-hot vector.
        body_name, body_digest: The body whose vertices are displaced.
        latent: Length of z.
        widths: Features of each block of the encoder, finest first; the generator mirrors them.
        levels: Level of the mesh hierarchy that each block works on.
        order: Chebyshev polynomials of a filter.
        residual: Whether blocks have a shortcut.
        conditional: Whether the generator is told pose and type.
        pose: "axis-angle" (the paper's 72 numbers) or "6d" (rotations below the pelvis and the direction of gravity).
        pose_code, type_code: Lengths that pose and type are compressed to.
        discriminator: "patch", "global" (one verdict a mesh) or "none".
        discriminator_widths, discriminator_levels: As of the encoder.
        normal_weight, kl_weight, adversarial_weight: Of the losses beside that of coordinates, in units of the data.
        variational: Whether z is drawn in training.
        components: Of the regression of ``anchored``, after which its rank is cut.
    """

    kind: str
    types: tuple[str, ...]
    body_name: str
    body_digest: str
    latent: int = 32
    widths: tuple[int, ...] = (8, 16, 32, 32)
    levels: tuple[int, ...] = (0, 2, 4, 6)
    order: int = 2
    residual: bool = True
    conditional: bool = True
    pose: str = "axis-angle"
    pose_code: int = 24
    type_code: int = 8
    discriminator: str = "patch"
    discriminator_widths: tuple[int, ...] = (8, 16, 16)
    discriminator_levels: tuple[int, ...] = (0, 2, 4)
    normal_weight: float = 0.1
    kl_weight: float = 1.0e-4
    adversarial_weight: float = 0.02
    variational: bool = True
    components: int = 64

    def __post_init__(self) -> None:
        for name in ("types", "widths", "levels", "discriminator_widths", "discriminator_levels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name, allowed in (("kind", KINDS), ("pose", tuple(POSES)), ("discriminator", DISCRIMINATORS)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"mesh VAE-GAN {name}: {getattr(self, name)!r} is not one of {', '.join(allowed)}")
        for ends in ("", "discriminator_"):
            widths, levels = getattr(self, f"{ends}widths"), getattr(self, f"{ends}levels")
            if len(widths) != len(levels) or not levels or list(levels) != sorted(levels):
                raise ValueError(f"mesh VAE-GAN {ends}levels: need one for each of {ends}widths, none falling")

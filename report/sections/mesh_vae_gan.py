"""Section: clothing as a layer on the body mesh."""

from __future__ import annotations

from report.sections.blocks import Run, Section

CONTROLS = "^mean layer$"
"""What every method has to beat; never the best."""


def section(run: Run) -> Section | None:
    """What the transfer loses, Table 1, what is generated; none where the run has no layers."""
    if not run.rows("mesh_vae_gan"):
        return None
    return Section(
        "mesh-vae-gan",
        "Clothing as a layer on the body",
        "Outfits brought to the mesh of the body as displacements of its vertices in the unposed space, and a network "
        "that makes such layers from a random code, a pose and a type of clothing.",
        [
            run.pictures("layer_types"),
            run.pictures("layer_poses"),
            run.pictures("layer_between"),
            *run.table("mesh_vae_gan", controls=CONTROLS),
            *run.table("mesh_vae_gan_generation"),
            *run.table("layer_transfer", mark=False),
        ],
    )

"""From layer files to the frames that stages of the Mesh VAE-GAN take."""

from __future__ import annotations

from collections.abc import Sequence

from datasets.layers import LayerExamples, joined_layers, read_layer
from pipeline.stage import Job


def job_layers(job: Job, paths: Sequence[str]) -> LayerExamples:
    """All types of the run, in the networks' numbering; ``ValueError`` where they are not those of the spec."""
    examples = joined_layers([read_layer(path) for path in paths])
    if list(examples.types) != list(job.spec["types"]):
        wanted = ", ".join(job.spec["types"])
        raise ValueError(f"{', '.join(paths)}: layers of types {', '.join(examples.types)}, expected {wanted}")
    return examples

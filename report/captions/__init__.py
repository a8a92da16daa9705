"""What is said about each table, chart and row of pictures: content, the paper's counterpart, origin and split.

One file a topic, each with its ``CAPTIONS``: by the name of the table (``tables/<name>.csv``) or chart, and
``pictures_<kind>`` for the pictures of a kind. A new topic is one more file and its name in ``TOPICS``.
"""

from __future__ import annotations

from collections import Counter

from report.captions import (
    collisions,
    composition,
    gallery,
    garment_regressor,
    gsnet,
    losses,
    mesh_vae_gan,
    motion_cvae,
    motion_invariant,
    run,
    shape_descriptor,
    simulation,
    systems,
    timing,
)
from report.captions.caption import Caption, made_by

__all__ = ["CAPTIONS", "TOPICS", "Caption", "made_by"]

TOPICS = (
    run,
    gallery,
    simulation,
    shape_descriptor,
    motion_invariant,
    composition,
    motion_cvae,
    garment_regressor,
    collisions,
    timing,
    gsnet,
    mesh_vae_gan,
    systems,
    losses,
)

_twice = [name for name, count in Counter(name for topic in TOPICS for name in topic.CAPTIONS).items() if count > 1]
if _twice:
    raise ValueError(f"report/captions: more than one caption is named {', '.join(_twice)}")

CAPTIONS: dict[str, Caption] = {name: caption for topic in TOPICS for name, caption in topic.CAPTIONS.items()}
"""All of them, by name."""

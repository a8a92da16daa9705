"""Captions: the loss curves."""

from __future__ import annotations

from report.captions.caption import Caption

CAPTIONS: dict[str, Caption] = {
    "losses": Caption(
        "Losses",
        "Logarithmic; blue: training, orange: validation. Losses of different networks have different units.",
        made="train_* → models/training.py → training/**/losses.csv",
    ),
}

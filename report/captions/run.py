"""Captions: the run itself."""

from __future__ import annotations

from report.captions.caption import Caption

CAPTIONS: dict[str, Caption] = {
    "stages": Caption(
        "Time and memory by stage",
        "Seconds of all jobs of a stage added up; jobs run side by side, so the run took less. Memory is the largest "
        "resident set of a job.",
        made="benchmark files of the workflow",
    ),
}

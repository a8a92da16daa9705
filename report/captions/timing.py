"""Captions: the time a frame."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "timing": Caption(
        "Seconds a frame",
        "Median and 95th percentile after a warm-up. The speed-up is against the implicit solver of this project on "
        "this machine, in this run.",
        "Shi 2023, Table 2; Wang 2019, section 3.6.",
        made_by("time_solvers", "sim/timing.py", "timing"),
        columns=(
            "garment",
            "solver",
            "vertices",
            "frames",
            "substeps",
            "median_s_per_frame",
            "p95_s_per_frame",
            "speed_up_over_implicit",
        ),
    ),
    "timing_bars": Caption(
        "Seconds a frame",
        "Logarithmic. Green: XPBD; yellow: implicit Euler; blue: networks; grey: ARCSim on other hardware.",
        "Shi 2023, Table 2.",
        "time_solvers → report/plots.py",
    ),
    "published_timing": Caption(
        "Times elsewhere",
        "Published on other hardware, or measured once outside of this run. Means, where no median was published.",
        "Shi 2023, Table 2; Wang 2019, section 3.6.",
        other=True,
    ),
}

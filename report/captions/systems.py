"""Captions: all systems side by side."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "systems": Caption(
        "All systems on one garment",
        "The same sequences, each dressed by every system as it leaves the network: nothing is projected out of the "
        "body. Each is told what the table says. Shi 2023: the motion; “conditioned”, the material too. Wang 2019: "
        "the motion, and the z of the material as the mean over other simulations of this garment in it, none of them "
        "a test sequence. Peng 2023: the motion, the material and the template, which it never saw in training; it "
        "learned on the wardrobe. Ma 2019: the pose and the type of clothing that covers the most alike, at z = 0, the "
        "middle of what it draws; it learned on outfits of another fabric on other bodies. Its layer moves the body's "
        "vertices: the layer error compares these, and those of everybody's garments; for the other columns it is "
        "carried to the garment's own vertices, at the cost of the row “layer of the truth”. Rows that see the "
        "truth are references (italic), a reconstruction too. A roll-out that diverges is held at ten metres.",
        "In none of the papers, which do not share data. Edge and bend: Peng 2023, Table 1; the simulation itself "
        "says what is right.",
        made_by("compare_systems", "evaluation/systems.py", "systems"),
        "Unseen motions: new clips in the base material, on which all compare. Both unseen: new clips in materials "
        "that nobody trained on; compare there what is told of the material (conditioned, Wang, Peng), for the others "
        "do not know of it. Times: processor time of one core, one clip, medians, without the simulator's own, which "
        "is of the table of timings. Training: seconds of a job on one thread, other jobs beside it; for Wang with the "
        "shape descriptor's. Sequences: as planned, before those that were dropped.",
        (
            "garment",
            "split",
            "paper",
            "method",
            "told",
            "error_mm",
            "layer_error_mm",
            "edge_mm",
            "bend",
            "collision_percent",
            "sted",
            "time_ms_per_frame",
            "parameters",
            "training_s",
        ),
    ),
    "pictures_systems": Caption(
        "One frame, dressed by all",
        "Upper row: the networks as published, smaller and briefly trained; lower row: ours. The first picture of each "
        "row is the simulation.",
        "In none of the papers.",
        "compare_systems → figures/systems/",
    ),
}

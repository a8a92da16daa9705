"""What the survey of cleanliness looks at: garments ready to be simulated, each with its material and its checker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from body.model import Body
    from sim.simulate import Simulator


@dataclass
class Subject:
    """A garment that is surveyed: its simulator, its material and its checker."""

    garment: str
    simulator: Simulator
    parameters: dict[str, float]
    check: object = field(init=False)

    def __post_init__(self) -> None:
        from sim.body_parts import handless
        from sim.crossings import CrossingChecker

        body, device = self.simulator.body, self.simulator.settings.device
        hands = ~handless(body.faces, body.skin_index, body.skin_weight)
        self.check = CrossingChecker(self.simulator.template.faces, body.faces, device, hands).check


def make_subjects(
    config: dict, body: Body, garments: Sequence[str], vertices: Sequence[int], substeps: int, device: str
) -> list[Subject]:
    """Every garment at every number of vertices, with its base material of the config.

    Raises:
        ValueError: The config has no such garment.
    """
    from garments.outfit import garment_spec, make_template
    from pipeline.spec import garment_geometry
    from sim.fabrics import base_values
    from sim.parameters import base_parameters
    from sim.settings import SimulationSettings
    from sim.simulate import Simulator

    settings = SimulationSettings(
        fps=config["motions"]["fps"], device=device, settle_seconds=config["simulation"]["settle"]
    )
    subjects = []
    for name in garments:
        if name not in config["garments"]:
            raise ValueError(f"unknown garment {name!r}: the config has {', '.join(config['garments'])}")
        geometry = garment_geometry(config, name)
        parameters = base_parameters(base_values(config["garments"][name]) | {"substeps": substeps})
        for count in vertices:
            template = make_template(garment_spec(name, _with_vertices(geometry, count)), body)
            subjects.append(Subject(name, Simulator(template, body, settings), parameters))
    return subjects


def _with_vertices(geometry: dict, count: int) -> dict:
    """The geometry with that many vertices; of an outfit, each of its garments."""
    if "worn" in geometry:
        return geometry | {"worn": [_with_vertices(one, count) for one in geometry["worn"]]}
    return geometry if geometry["kind"] == "mesh" else geometry | {"vertices": count}

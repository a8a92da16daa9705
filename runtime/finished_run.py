"""A finished run as its models are used: which garments it has, its body, and its trained networks.

In: the folder ``results/<run>``, whose ``config.json`` says what lies where. Out: loaded parts, each read when it is
first asked for. Model files are read as the untrusted files that they may be (``models.checkpoint``).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from body.model import Body
from datasets.codes import file_digest
from garments.grading import Grader
from garments.template import GarmentTemplate
from models.conditioned_regressor import ConditionedRegressor, load_conditioned_regressor
from models.garment_fitting import load_regressor
from models.garment_regressor import Regressor
from models.intrinsic_fitting import TrainedOn, load_motion_invariant
from models.motion_fitting import load_motion_cvae
from models.motion_generator import MotionGenerator
from models.motion_invariant import MotionInvariantNetwork
from models.refinement import RefinementSettings, Refiner
from models.shape_descriptor import ShapeDescriptor, load_shape_descriptor
from sim.fabrics import base_values
from sim.parameters import base_parameters, sample_parameters

CONDITIONED = "conditioned"
FINE_TUNED = "fine_tuned"

R = TypeVar("R", bound=Regressor)


@dataclass(frozen=True)
class FinishedRun:
    """The folder of a run and its configuration.

    Attributes:
        folder: ``results/<run>``.
        config: The whole configuration that it was made with.
    """

    folder: Path
    config: Mapping[str, Any]

    @classmethod
    def open(cls, folder: str | os.PathLike) -> FinishedRun:
        """Open a run's folder.

        Raises:
            ValueError: The folder or its configuration is missing or damaged; says what to run.
        """
        folder = Path(folder)
        path = folder / "config.json"
        if not folder.is_dir():
            raise ValueError(f"{folder}: no such run; `snakemake all` makes results/default")
        if not path.is_file():
            raise ValueError(f"{folder}: holds no finished run, {path.name} is missing; `snakemake all` makes it")
        try:
            config = json.loads(path.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise ValueError(f"{path} is damaged: {error}") from None
        needed = ("seed", "body", "motions", "garments", "models")
        if not isinstance(config, dict) or not all(isinstance(config.get(key), dict | int) for key in needed):
            raise ValueError(f"{path} is no configuration of a run: it needs {', '.join(needed)}")
        return cls(folder, config)

    @property
    def fps(self) -> float:
        """Frame rate of everything that was learned [Hz]."""
        return float(self.config["motions"]["fps"])

    @property
    def lead_in(self) -> int:
        """Frames from the bind pose into a motion."""
        return int(self.config["motions"]["lead_in"])

    @property
    def segment(self) -> int:
        """Frames of the motions that were learned from."""
        return int(self.config["motions"]["frames"])

    @property
    def shape(self) -> np.ndarray:
        """Shape coefficients of the run's own body [standard deviations], shape [<= 10]."""
        return np.asarray(self.config["body"]["shape"], dtype=np.float64)

    @cached_property
    def plain_body(self) -> Body:
        """The body without shape coefficients."""
        return Body.load(self.config["body"]["resolution"])

    @cached_property
    def body(self) -> Body:
        """The run's own body."""
        return self.plain_body.shaped(self.shape)

    @cached_property
    def generator(self) -> MotionGenerator:
        """The motion generator in use; ``ValueError`` says what to run where it is missing."""
        used = self.config["models"]["motion_cvae"]["use"]
        return load_motion_cvae(self._file("models", "motion", "motion_cvae", f"{used}.pt"))

    def garment(self, name: str) -> LearnedGarment:
        """A garment of the run; ``ValueError`` lists the known for another name."""
        if name not in self.config["garments"]:
            raise ValueError(f"garment {name!r} is not in {self.folder}; known: {', '.join(self.config['garments'])}")
        return LearnedGarment(self, name)

    def _file(self, *parts: str) -> Path:
        path = self.folder.joinpath(*parts)
        if not path.is_file():
            raise ValueError(f"{path} is missing: {self.folder} is not finished; `snakemake all` makes what lacks")
        return path


@dataclass(frozen=True)
class LearnedGarment:
    """A garment of a finished run, with what was trained on it."""

    run: FinishedRun
    name: str

    @cached_property
    def template(self) -> GarmentTemplate:
        """The garment at rest."""
        return GarmentTemplate.load(self.run._file("garments", f"{self.name}.npz"))

    @cached_property
    def grader(self) -> Grader:
        """Cuts the garment for other shapes of the run's body."""
        return Grader(self.template, self.run.body)

    @cached_property
    def regressor(self) -> Regressor:
        """The regressor in use, tuned against collisions: for the base material on the run's own body."""
        return self._fitting(load_regressor(self._model(FINE_TUNED)))

    @cached_property
    def conditioned(self) -> ConditionedRegressor:
        """The regressor that is told material and body; ``ValueError`` where the run trained none."""
        if CONDITIONED not in self.run.config["models"]["garment_regressor"]["variants"]:
            raise ValueError(
                f"{self.run.folder} trained no regressor that is told material and body; "
                f"add the variant '{CONDITIONED}' to models.garment_regressor and run `snakemake all`"
            )
        return self._fitting(load_conditioned_regressor(self._model(CONDITIONED)))

    @property
    def descriptor_path(self) -> Path:
        """Model file of the shape descriptor in use."""
        used = self.run.config["models"]["shape_descriptor"]["use"]
        return self.run._file("models", self.name, "shape_descriptor", f"{used}.pt")

    @property
    def codes_path(self) -> Path:
        """All simulated frames as the descriptors that it made (``datasets.codes``)."""
        return self.run._file("codes", f"{self.name}.h5")

    @cached_property
    def descriptor(self) -> ShapeDescriptor:
        """The shape descriptor in use; ``ValueError`` where it is of another garment."""
        return load_shape_descriptor(self.descriptor_path, self.template.faces)

    @cached_property
    def autoencoder(self) -> MotionInvariantNetwork:
        """The motion-invariant autoencoder in use; ``ValueError`` where it is of another garment or descriptor."""
        used = self.run.config["models"]["motion_invariant"]["use"]
        path = self.run._file("models", self.name, "motion_invariant", f"{used}.pt")
        code, trained_on = self.descriptor.config.code, TrainedOn(self.name, file_digest(self.descriptor_path))
        network = load_motion_invariant(path, trained_on)
        # An earlier version's file does not say what it was trained on.
        if len(network.descriptor_mean) != code:
            raise ValueError(
                f"{path} was trained on descriptors of {len(network.descriptor_mean)} numbers, that of '{self.name}' "
                f"has {code}; run `snakemake all`"
            )
        return network

    @cached_property
    def base_parameters(self) -> dict[str, float]:
        """Every intrinsic parameter of the base material."""
        return base_parameters(base_values(self.run.config["garments"][self.name]))

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Between what each sampled parameter was sampled."""
        ranges = self.run.config["garments"][self.name].get("ranges", {})
        return {name: (float(ends["min"]), float(ends["max"])) for name, ends in ranges.items()}

    def sampled_parameters(self, seed: int, number: int) -> dict[str, float]:
        """Intrinsic parameters as the data plan samples them; ``number`` from 1."""
        return sample_parameters(self.base_parameters, self.ranges, seed, self.name, number)

    def refiner(self, body: Body) -> Refiner:
        """Takes a garment out of a body, with the run's settings."""
        settings = RefinementSettings(**self.run.config["models"]["refinement"])
        return Refiner(self.template.topology, body.faces, len(body.vertices), settings)

    def _model(self, variant: str) -> Path:
        return self.run._file("models", self.name, "garment_regressor", f"{variant}.pt")

    def _fitting(self, regressor: R) -> R:
        if regressor.config.vertices != len(self.template.vertices):
            raise ValueError(
                f"{self.run.folder}: the regressor of '{self.name}' was trained on {regressor.config.vertices} "
                f"vertices, its template has {len(self.template.vertices)}; run `snakemake all`"
            )
        # Garments are often made with one number of vertices; their triangles differ.
        if not np.array_equal(regressor.shape.faces.numpy(force=True), self.template.faces):
            raise ValueError(
                f"{self.run.folder}: the regressor of '{self.name}' was trained on other triangles than its "
                "template's; run `snakemake all`"
            )
        return regressor

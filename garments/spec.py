"""What a user may ask of a garment: kind, resolution and measures in metres, each with its default and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Measure:
    """One measure of a garment kind.

    Attributes:
        meaning: What it is, with its unit.
        default: Value when none is given; None means "taken from the body", as the meaning says.
        low, high: Allowed limits.
    """

    meaning: str
    default: float | None
    low: float
    high: float


CLOSE = "radius of the ball that bridges hollows such as the armpits and the small of the back [m]"
NECK = "distance of the neckline from the base of the neck [m]"
STRAP = "width of the fabric over each shoulder, where there are no sleeves [m]"
SLEEVE = "shoulder joint to sleeve hem [m]; 0: no sleeves"
SHORTEST_SLEEVE = 0.08
"""A shorter sleeve ends in the armpit [m]."""

MEASURES: dict[str, dict[str, Measure]] = {
    "skirt": {
        "length": Measure("waist to hem [m]; from the body: to the knee", None, 0.15, 1.1),
        "ease": Measure("gap to the body at the hips [m]", 0.010, 0.003, 0.10),
        "flare": Measure("growth of the radius per metre of height [m/m]", 0.25, 0.0, 1.2),
    },
    "tshirt": {
        "length": Measure("neck joint to hem [m]; from the body: to the hip joints", None, 0.35, 0.9),
        "ease": Measure("gap to the body at the chest [m]", 0.012, 0.004, 0.03),
        "flare": Measure("growth of the gap per metre below the armpits [m/m]", 0.05, 0.0, 0.15),
        "sleeve": Measure(
            "shoulder joint to sleeve hem [m]; from the body: just past the middle of the upper arm", None, 0.08, 0.55
        ),
        "neck": Measure(NECK, 0.010, 0.0, 0.05),
        "close": Measure(CLOSE, 0.035, 0.015, 0.08),
    },
    "top": {
        "length": Measure("neck joint to hem [m]; from the body: to the hip joints", None, 0.30, 0.9),
        "ease": Measure("gap to the body at the chest [m]", 0.010, 0.004, 0.03),
        "flare": Measure("growth of the gap per metre below the armpits [m/m]", 0.05, 0.0, 0.15),
        "neck": Measure(NECK, 0.010, 0.0, 0.03),
        "strap": Measure(STRAP, 0.07, 0.05, 0.10),
        "close": Measure(CLOSE, 0.030, 0.015, 0.06),
    },
    "jumpsuit": {
        "length": Measure("neck joint to hem [m]; from the body: just above the ankles", None, 0.7, 1.6),
        "ease": Measure("gap to the body [m]", 0.014, 0.006, 0.05),
        "flare": Measure("growth of the gap per metre below the crotch [m/m]", 0.03, 0.0, 0.10),
        "sleeve": Measure(SLEEVE, 0.0, 0.0, 0.55),
        "neck": Measure(NECK, 0.010, 0.0, 0.03),
        "strap": Measure(STRAP, 0.07, 0.05, 0.10),
        "close": Measure(CLOSE, 0.030, 0.015, 0.06),
    },
    "dress": {
        "length": Measure("neck joint to hem [m]; from the body: to the knee", None, 0.6, 1.6),
        "ease": Measure("gap to the body at the chest [m]", 0.010, 0.004, 0.03),
        "flare": Measure("growth of the skirt's radius per metre below the waist [m/m]", 0.25, 0.0, 0.8),
        "sleeve": Measure(SLEEVE, 0.0, 0.0, 0.32),
        "neck": Measure(NECK, 0.010, 0.0, 0.03),
        "strap": Measure(STRAP, 0.07, 0.05, 0.10),
        "close": Measure(CLOSE, 0.030, 0.015, 0.06),
    },
    "pants": {
        "length": Measure("waist to hem [m]; from the body: just above the ankles", None, 0.25, 1.2),
        "ease": Measure("gap to the body at hips and legs [m]", 0.012, 0.004, 0.05),
        "flare": Measure("growth of the gap per metre below the crotch [m/m]", 0.03, 0.0, 0.10),
        "close": Measure(CLOSE, 0.030, 0.015, 0.06),
    },
}
"""Measures of every garment kind; a measure that a kind lacks may not be given for it."""

VERTEX_LIMITS: dict[str, tuple[int, int]] = {
    "skirt": (200, 12_600),
    "tshirt": (350, 12_600),
    "top": (350, 12_600),
    "pants": (400, 12_600),
    "jumpsuit": (600, 12_600),
    "dress": (450, 12_600),
}
"""Fewer vertices than the lower limit tear sleeves or legs; the upper one is the largest published garment."""


@dataclass(frozen=True)
class GarmentSpec:
    """A garment to build on a body; None takes the kind's default of ``MEASURES``.

    Attributes:
        name: Name of the garment in files and tables.
        kind: One of ``MEASURES``, which says what each of the following means for it.
        vertices: Vertices of the mesh, met exactly.
        length: Waist (of what hangs from the shoulders: neck joint) to hem, straight down [m].
        ease: Gap between body and garment [m].
        flare: Widening towards the hem [m/m].
        sleeve: Shoulder joint to sleeve hem, along the arm [m]; 0: no sleeves.
        neck: Distance of the neckline from the base of the neck [m].
        strap: Width of the fabric over each shoulder, where there are no sleeves [m].
        close: Radius of the ball that bridges hollows of the body [m].

    Raises:
        ValueError: with one sentence that names the field and what is allowed.
    """

    name: str
    kind: str
    vertices: int
    length: float | None = None
    ease: float | None = None
    flare: float | None = None
    sleeve: float | None = None
    neck: float | None = None
    strap: float | None = None
    close: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError("garment: 'name' must be a non-empty text")
        where = f"garment '{self.name}'"
        if self.kind not in MEASURES:
            raise ValueError(f"{where}: unknown kind {self.kind!r}, known kinds are {', '.join(sorted(MEASURES))}")
        low, high = VERTEX_LIMITS[self.kind]
        if isinstance(self.vertices, bool) or not isinstance(self.vertices, int) or not low <= self.vertices <= high:
            raise ValueError(
                f"{where}: 'vertices' of {self.kind} must be a whole number in {low}..{high}, got {self.vertices!r}"
            )
        for field in ("length", "ease", "flare", "sleeve", "neck", "strap", "close"):
            value = getattr(self, field)
            if value is None:
                continue
            if field not in MEASURES[self.kind]:
                known = ", ".join(MEASURES[self.kind])
                raise ValueError(f"{where}: {self.kind} has no measure '{field}', it has {known}")
            measure = MEASURES[self.kind][field]
            number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
            if not number or not measure.low <= value <= measure.high:
                raise ValueError(
                    f"{where}: '{field}' must lie in {measure.low}..{measure.high}, got {value!r} ({measure.meaning})"
                )
        if self.sleeve is not None and 0.0 < self.sleeve < SHORTEST_SLEEVE:
            raise ValueError(
                f"{where}: 'sleeve' must be 0 (no sleeves) or at least {SHORTEST_SLEEVE}, got {self.sleeve!r}"
            )
        if self.strap is not None and self.has_sleeves:
            raise ValueError(f"{where}: 'strap' is of a garment without sleeves, but 'sleeve' is {self.sleeve!r}")

    @property
    def has_sleeves(self) -> bool:
        """Whether the arms are in sleeves, if only to the middle of the upper arm."""
        if "sleeve" not in MEASURES[self.kind]:
            return False
        length = MEASURES[self.kind]["sleeve"].default if self.sleeve is None else self.sleeve
        return length is None or length > 0.0

    def measure(self, field: str, from_body: float | None = None) -> float:
        """The value of a measure: as given, else its default, else what the body says [m]."""
        value = getattr(self, field)
        if value is None:
            value = MEASURES[self.kind][field].default
        if value is None:
            value = from_body
        if value is None:
            raise ValueError(f"garment '{self.name}': '{field}' is neither given nor known from the body")
        return float(value)


@dataclass(frozen=True)
class Worn:
    """How a garment of some kind is worn.

    Attributes:
        held: What is held to the body unless the user says otherwise, one of ``HELD``.
        arms: Whether it is worn on the arms.
    """

    held: str
    arms: bool


WORN_AS = {
    "skirt": Worn("top", arms=False),
    "pants": Worn("top", arms=False),
    "tshirt": Worn("none", arms=True),
    "top": Worn("none", arms=True),
    "jumpsuit": Worn("none", arms=True),
    "dress": Worn("none", arms=True),
}
"""What a user's own mesh can be worn as. A skirt and a dress hang around both legs at once."""

HELD = ("none", "top", "waist")
"""Held to the body: nothing, the vertices of the topmost opening, or those of a band at the natural waist."""

SCALES = (1.0e-4, 1.0e3)
"""Limits of the length of one unit of a mesh file [m]."""


@dataclass(frozen=True)
class MeshGarmentSpec:
    """A garment from a user's mesh file, modelled on the body in its bind pose.

    Attributes:
        name: Name of the garment in files and tables.
        file: OBJ, PLY or binary glTF file.
        worn_as: One of ``WORN_AS``.
        scale: Length of one unit of the file [m]: 0.01 for centimetres.
        held: One of ``HELD``; None takes what ``worn_as`` says.

    Raises:
        ValueError: with one sentence that names the field and what is allowed.
    """

    name: str
    file: str
    worn_as: str
    scale: float = 1.0
    held: str | None = None

    def __post_init__(self) -> None:
        where = f"garment '{self.name}'"
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError("garment: 'name' must be a non-empty text")
        if self.worn_as not in WORN_AS:
            raise ValueError(f"{where}: 'worn_as' must be one of {', '.join(WORN_AS)}, got {self.worn_as!r}")
        if self.held is None:
            object.__setattr__(self, "held", WORN_AS[self.worn_as].held)
        if self.held not in HELD:
            raise ValueError(f"{where}: 'held' must be one of {', '.join(HELD)}, got {self.held!r}")
        number = isinstance(self.scale, (int, float)) and not isinstance(self.scale, bool)
        if not number or not SCALES[0] <= self.scale <= SCALES[1]:
            raise ValueError(f"{where}: 'scale' must lie in {SCALES[0]:g}..{SCALES[1]:g} m, got {self.scale!r}")


@dataclass(frozen=True)
class OutfitSpec:
    """Garments worn over each other.

    Attributes:
        name: Name of the outfit in files and tables.
        worn: Its garments, innermost first, each with a name of its own.

    Raises:
        ValueError: with one sentence that names the field and what is allowed.
    """

    name: str
    worn: tuple[GarmentSpec | MeshGarmentSpec, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError("outfit: 'name' must be a non-empty text")
        names = [one.name for one in self.worn]
        if len(names) < 2 or not all(isinstance(one, (GarmentSpec, MeshGarmentSpec)) for one in self.worn):
            raise ValueError(f"outfit '{self.name}': 'worn' must list at least two garments, got {len(names)}")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"outfit '{self.name}': two garments are called '{twice}', each needs a name of its own")

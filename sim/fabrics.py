"""Named fabrics: intrinsic parameters of real cloth, each number with where it comes from.

A fabric holds only what is known of it; everything else stays at the base value of ``sim.parameters``. Nobody measured
damping, yield curvature or drag of these samples, so no fabric sets them.

Three kinds of sources, the best first; a number's ``source`` begins with one of these words:

- *measured*: a published measurement of this fabric, brought into the meaning of our energies (``sim.rest_state``).
- *derived*: follows from published numbers by a stated rule.
- *assumed*: nothing was found for this fabric; what was taken instead is said.

From Wang, O'Brien & Ramamoorthi 2011 (*Data-driven elastic models for cloth*, ACM TOG 30(4):71) as ARCSim reads it:

- ARCSim's membrane energy an area is ``1/2 k0 Guu^2 + k1 Guu Gvv + 1/2 k2 Gvv^2 + k3 Guv^2`` with the Green strain G
  and ``k = 2 [C11, C12, C22, C33]`` of the file. At small strain ``Guu = |w_u| - 1`` and ``Guv = w_u . w_v / 2``. Ours
  is ``k_stretch/2 ((|w_u| - 1)^2 + (|w_v| - 1)^2) + k_shear/2 (w_u . w_v)^2``. So ``k_shear = C33``, and ``k_stretch``
  is the geometric mean of ``2 C11`` and ``2 C22``, because we have one stiffness for warp and weft. C12 has no
  counterpart. The row for zero strain is used: garments mostly strain by a few per cent.
- ARCSim's bending energy of an edge is ``ke l^2 theta^2 / (8 (A0 + A1))``. Ours is ``k/2 l^2 theta^2 / (A0 + A1)`` for
  small angles, which gives ``k/2`` times the squared curvature an area when cloth is rolled to a cylinder. So
  ``k_bend = ke / 4``. The directions 0, 45 and 90 degrees are averaged over the circle, where 45 counts twice.

From Feng et al. 2022 (*Learning-based bending stiffness parameter estimation by a drape tester*, 618 fabrics without
names): the median bending stiffness at no curvature, averaged over directions in the same way, of the distinct fabrics
within 5% of a density; 12 to 18 fabrics each.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from sim.parameters import PARAMETER_NAMES, parameter

_WANG = "Wang, O'Brien & Ramamoorthi 2011, sample {sample} ({content}), as distributed with ARCSim"
_FENG = "derived: median of the fabrics of Feng et al. 2022 within 5% of this density"
_PENAVA = "measured: Penava, Simic Penava & Knezic 2014, Table 1"
_EPIC = "derived: Epic Games, Chaos Cloth of Unreal Engine 5.4, reference of a default fabric's density"
_TEMEL = (
    "derived: Temel, Johnson & Lloyd 2022 (Tribology Letters 70), dynamic friction of cotton on skin, from 0.25 "
    "(forearm) to 0.79 (chest): their geometric mean"
)
_COTTON_ON_SKIN = float(np.sqrt(0.25 * 0.79))


@dataclass(frozen=True)
class Sample:
    """One cloth of Wang et al. 2011: the part of the measurement that our model has a place for.

    Attributes:
        name: Name of the sample.
        content: Fibres and use.
        density: [kg/m^2].
        stretching: C11, C22 and C33 at zero strain, as in the published file [N/m].
        bending: ke at the lowest measured curvature in the directions 0, 45 and 90 degrees [N m].
    """

    name: str
    content: str
    density: float
    stretching: tuple[float, float, float]
    bending: tuple[float, float, float]

    @property
    def source(self) -> str:
        """Paper and sample."""
        return _WANG.format(sample=self.name, content=self.content)

    @property
    def stretch(self) -> float:
        """Membrane stiffness along the yarns in our energy [N/m]."""
        return float(np.sqrt(2.0 * self.stretching[0] * 2.0 * self.stretching[1]))

    @property
    def shear(self) -> float:
        """Shear stiffness in our energy [N/m]."""
        return self.stretching[2]

    @property
    def bend(self) -> float:
        """Bending stiffness in our energy [N m]."""
        along, diagonal, across = self.bending
        return (along + 2.0 * diagonal + across) / 4.0 / 4.0


@dataclass(frozen=True)
class Fabric:
    """A named cloth.

    Attributes:
        name: Key in configs.
        description: What it is.
        values: Intrinsic parameters in SI units, by name.
        sources: Where each of them comes from, by the same names.
    """

    name: str
    description: str
    values: Mapping[str, float]
    sources: Mapping[str, str]

    def __post_init__(self) -> None:
        if set(self.values) != set(self.sources):
            raise ValueError(f"fabric {self.name!r}: every value needs a source, and every source a value")
        for name, value in self.values.items():
            low, high = parameter(name).allowed
            if not low <= value <= high:
                raise ValueError(f"fabric {self.name!r}: {name} = {value}: allowed are {low:g} to {high:g}")


def kes_bending(b: float) -> float:
    """Bending stiffness [N m] from KES-F's B [gf cm^2/cm]: 1 gf = 9.80665e-3 N, so 1 gf cm^2/cm = 9.80665e-5 N m."""
    return b * 9.80665e-5


def kes_shear(g: float) -> float:
    """Shear stiffness [N/m] from KES-F's G [gf/(cm degree)]: 1 gf/cm = 0.980665 N/m, and the angle in radians."""
    return g * 0.980665 * 180.0 / np.pi


def fabric(name: str) -> Fabric:
    """The fabric of that name; ``ValueError`` names the known ones."""
    if name not in FABRICS:
        close = difflib.get_close_matches(str(name), FABRICS, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise ValueError(f"unknown fabric {name!r}{hint}; allowed are {', '.join(FABRICS)}")
    return FABRICS[name]


def base_values(settings: Mapping[str, Any]) -> dict[str, float]:
    """A garment's own base values by its config: those of its ``fabric``, if it names one, and ``base`` over them."""
    given = dict(fabric(settings["fabric"]).values) if "fabric" in settings else {}
    given |= settings.get("base", {})
    return {name: float(given[name]) for name in PARAMETER_NAMES if name in given}


SAMPLES: Mapping[str, Sample] = MappingProxyType(
    {
        sample.name: sample
        for sample in (
            Sample(
                "gray-interlock",
                "60% cotton 40% polyester, T-shirt",
                0.187,
                (16.593832, 34.477123, 36.860302),
                (23.191698e-6, 24.749964e-6, 14.267624e-6),
            ),
            Sample(
                "11oz-black-denim",
                "99% cotton 1% spandex, jeans",
                0.324,
                (205.352005, 1013.88629, 53.387184),
                (64.196457e-6, 73.384567e-6, 96.951576e-6),
            ),
            Sample(
                "ivory-rib-knit",
                "95% cotton 5% spandex, underwear",
                0.276,
                (42.871021, 65.166023, 83.175644),
                (46.237591e-6, 30.015930e-6, 32.243889e-6),
            ),
            Sample(
                "camel-ponte-roma",
                "60% polyester 40% rayon, jacket",
                0.284,
                (31.146198, 44.028667, 31.896357),
                (36.348366e-6, 33.013252e-6, 37.157593e-6),
            ),
            Sample(
                "tango-red-jet-set",
                "100% polyester, jacket",
                0.113,
                (43.067627, 171.424835, 14.314700),
                (14.293814e-6, 21.951700e-6, 20.345654e-6),
            ),
            Sample(
                "royal-target",
                "65% cotton 35% polyester, pants",
                0.220,
                (2016.55456, 2034.97644, 104.759674),
                (125.409805e-6, 107.997696e-6, 125.409805e-6),
            ),
            Sample(
                "white-dots-on-blk",
                "100% polyester, tablecloth",
                0.128,
                (2002.08618, 2027.48559, 19.189022),
                (51.713814e-6, 40.659470e-6, 31.282822e-6),
            ),
            Sample(
                "white-swim-solid",
                "87% nylon 13% spandex, swimsuit",
                0.204,
                (47.971176, 104.615456, 60.773663),
                (60.237942e-6, 58.803211e-6, 51.018833e-6),
            ),
        )
    }
)
"""Cloth of Wang et al. 2011 that fabrics are made of."""


def _from_sample(name: str, description: str, sample_name: str, **more: tuple[float, str]) -> Fabric:
    sample = SAMPLES[sample_name]
    known = {
        key: (getattr(sample, key), f"measured: {sample.source}") for key in ("density", "stretch", "shear", "bend")
    }
    return _fabric(name, description, **known, **more)


def _fabric(name: str, description: str, **numbers: tuple[float, str]) -> Fabric:
    values = {key: float(value) for key, (value, _) in numbers.items()}
    sources = {key: source for key, (_, source) in numbers.items()}
    return Fabric(name, description, MappingProxyType(values), MappingProxyType(sources))


def _weave_like(sample_name: str, why: str) -> dict[str, tuple[float, str]]:
    """Stretch and shear of a measured sample, for a fabric that nobody measured them of."""
    sample = SAMPLES[sample_name]
    source = f"assumed: as {sample.source}: {why}"
    return {"stretch": (sample.stretch, source), "shear": (sample.shear, source)}


def _leather() -> Fabric:
    """Leather has no yarns: bending tells the membrane of an even sheet of thickness h, ``12 B (1 - nu^2) / h^2``."""
    bend, thickness, poisson = float(np.sqrt(9.2e-5 * 22.0e-5)), 0.8e-3, 0.3
    young = 12.0 * bend * (1.0 - poisson**2) / thickness**2
    even = "derived: an even sheet of this bending stiffness, 0.8 mm thick (middle of Memon et al. 2021), Poisson's 0.3"
    return _fabric(
        "leather",
        "garment leather of sheep, 0.8 mm",
        density=(0.45, f"{_EPIC}: light leather 0.3, heavy leather 0.6; their mean"),
        stretch=(young, even),
        shear=(young / (2.0 * (1.0 + poisson)), even),
        bend=(
            bend,
            "derived: Memon et al. 2021 (Materials 14, 4553), flexural rigidity 9.2 to 22, geometric mean; the "
            "abstract gives no unit, mN cm is the one that fits its thickness and drape",
        ),
    )


FABRICS: Mapping[str, Fabric] = MappingProxyType(
    {
        f.name: f
        for f in (
            _fabric(
                "cotton",
                "plain cotton weave of shirts and skirts",
                density=(0.1503, _PENAVA),
                **_weave_like("royal-target", "the one sample that is mostly cotton and stiff along both yarns"),
                bend=(1.5e-5, _FENG),
                friction=(_COTTON_ON_SKIN, _TEMEL),
            ),
            _from_sample("denim", "11 oz denim of jeans", "11oz-black-denim", friction=(_COTTON_ON_SKIN, _TEMEL)),
            _from_sample("twill", "cotton blend of pants", "royal-target", friction=(_COTTON_ON_SKIN, _TEMEL)),
            _from_sample("jersey", "interlock knit of T-shirts", "gray-interlock", friction=(_COTTON_ON_SKIN, _TEMEL)),
            _from_sample("rib_knit", "rib knit of underwear", "ivory-rib-knit", friction=(_COTTON_ON_SKIN, _TEMEL)),
            _from_sample("ponte", "firm double knit of jackets and dresses", "camel-ponte-roma"),
            _from_sample("polyester", "thin polyester of jackets", "tango-red-jet-set"),
            _from_sample("nylon", "elastic nylon of swimwear", "white-swim-solid"),
            _fabric(
                "silk",
                "light silk weave of blouses and scarfs",
                density=(0.1, _EPIC),
                **_weave_like("white-dots-on-blk", "the lightest sample that is stiff along both yarns"),
                bend=(3.5e-6, _FENG),
            ),
            _fabric(
                "wool",
                "wool weave of suits",
                density=(0.2348, _PENAVA),
                **_weave_like("royal-target", "the weave nearest in density"),
                bend=(1.4e-5, _FENG),
            ),
            _fabric(
                "linen",
                "crisp linen weave of shirts and summer dresses",
                density=(
                    0.18,
                    "assumed: no measurement was found; between the cotton and the wool of Penava et al. 2014",
                ),
                **_weave_like("royal-target", "the weave nearest in density; no linen was found"),
                bend=(
                    2.5e-5,
                    "assumed: upper quartile, for linen is crisp, of Feng et al. 2022 within 5% of this density",
                ),
            ),
            _leather(),
        )
    }
)
"""The fabrics by name."""

"""How far each intrinsic parameter can go (Wang 2019, section 4): one at a time, the others at their base values, until
the simulator fails or its result is unreasonable.

In: base values, which parameters, and a function that tries parameter sets. Out: for each parameter the interval around
its base in which every trial held, what stopped it at either end, and all trials. The search knows nothing of the
simulator, so that it can be tested on functions whose limits are known.

Each end is a search of its own, from the base value outwards: steps that double until a trial fails or a limit is
reached, then bisection between the last good and the first bad value. Logarithmic parameters are walked in their
logarithm. The searches take turns, so that a simulator which runs many parameter sets at once gets many at once. A
range that fails and holds again farther out is not looked for: the interval is the one that holds the base value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from sim.parameters import IntrinsicParameter, parameter, sample_parameters

LOWEST_SHARE = 1.0e-3
"""A logarithmic parameter whose physical limit is zero is followed down to this share of its base value."""

CRITERIA: dict[str, tuple[str, str]] = {
    "p99_edge_strain": ("p99 edge strain", ""),
    "penetration": ("penetration", " m"),
    "vertices_inside": ("share of vertices inside the body", ""),
    "residual_speed": ("residual speed", " m/s"),
    "jitter": ("p99 acceleration", " m/s^2"),
}
"""Figures that are judged: what they are called, and their unit."""

FAILED = "simulator failed"
LIMIT = "limit"
"""Causes of an end besides the names in ``CRITERIA``; ``LIMIT``: it held as far as it may go."""


@dataclass(frozen=True)
class Outcome:
    """What came of a parameter set.

    Attributes:
        figures: Figures of ``CRITERIA`` that were measured.
        cause: Name of the criterion that was missed, or ``FAILED``; None where all held.
        sentence: The same in one sentence with the numbers, empty where all held.
    """

    figures: Mapping[str, float]
    cause: str | None = None
    sentence: str = ""


@dataclass(frozen=True)
class Trial:
    """One tried value of one parameter, the others at their base values."""

    parameter: str
    value: float
    outcome: Outcome


@dataclass(frozen=True)
class FoundRange:
    """Interval of a parameter in which every trial held.

    Attributes:
        parameter: Its name.
        base: Base value.
        low: Lowest value that held.
        high: Highest value that held.
        low_stop: What stopped the search below: a failed outcome, or None at the limit.
        high_stop: The same above.
    """

    parameter: str
    base: float
    low: float
    high: float
    low_stop: Outcome | None
    high_stop: Outcome | None

    def narrowed(self, share: float) -> tuple[float, float]:
        """The interval shortened to a share of its way from the base value to either end, on the parameter's scale."""
        ends = [_between(parameter(self.parameter), self.base, end, share) for end in (self.low, self.high)]
        return ends[0], ends[1]


@dataclass(frozen=True)
class SearchSettings:
    """How the searches go.

    Attributes:
        factor: First step of a logarithmic parameter; each step is the square of the one before.
        share: First step of a linear parameter as a share of the way to its limit; each step is twice the one before.
        bisections: Halvings between the last good and the first bad value.
    """

    factor: float = 2.0
    share: float = 0.125
    bisections: int = 3

    def __post_init__(self) -> None:
        if not self.factor > 1.0 or not 0.0 < self.share <= 1.0 or self.bisections < 0:
            raise ValueError(
                f"range search: factor = {self.factor}, share = {self.share} and bisections = {self.bisections}: "
                "allowed are above 1, above 0 to 1, and 0 or more"
            )


Evaluate = Callable[[Sequence[Mapping[str, float]]], Sequence[Outcome]]
"""Tries parameter sets; one outcome each, in order."""


def judge(figures: Mapping[str, float], bounds: Mapping[str, float], failure: str | None = None) -> Outcome:
    """Hold figures against bounds: the first criterion that is missed decides; a figure that is not a number misses.

    Args:
        figures: Figures by the names of ``CRITERIA``.
        bounds: Largest allowed figure by the same names; criteria without a bound are not judged.
        failure: Why the simulator failed, None where it ran to its end.
    """
    if failure is not None:
        return Outcome(figures, FAILED, failure)
    for name, (label, unit) in CRITERIA.items():
        if name in bounds and not figures[name] <= bounds[name]:
            return Outcome(figures, name, f"{label} {figures[name]:.3g}{unit} above {bounds[name]:g}{unit}")
    return Outcome(figures)


def find_ranges(
    base: Mapping[str, float],
    names: Sequence[str],
    evaluate: Evaluate,
    settings: SearchSettings | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[list[FoundRange], list[Trial]]:
    """Search both ends of every named parameter.

    Args:
        base: Base value of every parameter.
        names: Parameters to vary.
        evaluate: Tries parameter sets; it gets as many at once as there are searches left.
        settings: Steps and bisections.
        limits: Limits of some parameters, narrower than the physical ones.

    Returns:
        One range a parameter, in order, and all trials in the order in which they were made.

    Raises:
        ValueError: The base set itself does not hold, or limits do not hold the base value.
    """
    settings, limits = settings or SearchSettings(), limits or {}
    first = evaluate([dict(base)])[0]
    if first.cause is not None:
        raise ValueError(f"range search: the base values themselves do not hold: {first.sentence}")
    ends = [_End.of(parameter(name), base[name], side, settings, limits.get(name)) for name in names for side in (0, 1)]
    trials: list[Trial] = []
    while asking := [end for end in ends if not end.done]:
        values = [end.next_value() for end in asking]
        outcomes = evaluate([{**base, end.parameter.name: value} for end, value in zip(asking, values)])
        for end, value, outcome in zip(asking, values, outcomes):
            end.tell(outcome)
            trials.append(Trial(end.parameter.name, value, outcome))
    found = []
    for name, low, high in zip(names, ends[0::2], ends[1::2]):
        found.append(FoundRange(name, base[name], low.best, high.best, low.stop, high.stop))
    return found, trials


def widest_common_share(
    found: Sequence[FoundRange],
    base: Mapping[str, float],
    evaluate: Evaluate,
    sets: int,
    accepted: float,
    share: float = 1.0,
    smaller: float = 0.75,
    least: float = 0.1,
    seed: int = 0,
    free: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[float, float]:
    """The share of all ranges at which parameters may be drawn together.

    Each range was found with the others at their base values; drawn together, far ends add up. So the ranges are
    narrowed on their scales around the base values until enough random sets hold.

    Args:
        found: Ranges that were found one at a time.
        base: Base value of every parameter.
        evaluate: Tries parameter sets.
        sets: Random sets a share.
        accepted: Share of the sets that must hold.
        share: Share of the ranges to begin with.
        smaller: Factor on the share at every further attempt.
        least: Smallest share that is tried.
        seed: Of the random sets.
        free: Further parameters that are drawn over fixed intervals.

    Returns:
        The share of the ranges and the share of the sets that held there.
    """
    while True:
        ranges = {r.parameter: r.narrowed(share) for r in found} | dict(free or {})
        drawn = [sample_parameters(base, ranges, seed, "ranges", index + 1) for index in range(sets)]
        held = sum(outcome.cause is None for outcome in evaluate(drawn)) / sets
        if held >= accepted or share * smaller < least:
            return share, held
        share *= smaller


def _between(p: IntrinsicParameter, base: float, end: float, way: float) -> float:
    """The value at a share of the way from the base value to an end, on the parameter's scale."""
    if way >= 1.0:
        return end
    if p.logarithmic and base > 0.0 and end > 0.0:
        value = base * (end / base) ** way
    else:
        value = base + (end - base) * way
    return float(round(value)) if p.integer else value


@dataclass
class _End:
    """Search of one end of one parameter; ways are shares of the way from the base value to the limit."""

    parameter: IntrinsicParameter
    base: float
    limit: float
    step: float
    bisections: int
    best: float
    good: float = 0.0
    bad: float | None = None
    stop: Outcome | None = None
    done: bool = False
    asked: float = field(default=0.0, repr=False)

    @classmethod
    def of(
        cls,
        p: IntrinsicParameter,
        base: float,
        side: int,
        settings: SearchSettings,
        limits: tuple[float, float] | None,
    ) -> _End:
        allowed = limits or p.allowed
        if not p.allowed[0] <= allowed[0] <= base <= allowed[1] <= p.allowed[1]:
            raise ValueError(
                f"range search: {p.name}: limits {allowed[0]:g} to {allowed[1]:g} must hold the base value {base:g} "
                f"and lie within {p.allowed[0]:g} to {p.allowed[1]:g} {p.unit}"
            )
        limit, step = allowed[side], settings.share
        if p.logarithmic and base > 0.0:
            limit = limit if limit > 0.0 else LOWEST_SHARE * base
            way = abs(math.log(limit / base))
            step = min(1.0, math.log(settings.factor) / way) if way > 0.0 else 1.0
        return cls(p, base, limit, step, settings.bisections, best=base, done=limit == base)

    def next_value(self) -> float:
        self.asked = min(1.0, self.good + self.step) if self.bad is None else 0.5 * (self.good + self.bad)
        return self._value(self.asked)

    def tell(self, outcome: Outcome) -> None:
        """Take the outcome of the value that was asked for."""
        halved = self.bad is not None
        if outcome.cause is None:
            self.good, self.best = self.asked, self._value(self.asked)
            self.step *= 2.0
            self.done = self.good >= 1.0
        else:
            self.bad, self.stop = self.asked, outcome
        if halved:
            self.bisections -= 1
        if self.bad is not None:
            between = self._value(0.5 * (self.good + self.bad))
            exhausted = self.parameter.integer and between in (self.best, self._value(self.bad))
            self.done = self.bisections <= 0 or exhausted

    def _value(self, way: float) -> float:
        return _between(self.parameter, self.base, self.limit, way)

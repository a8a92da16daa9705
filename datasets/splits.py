"""Splits by disjoint parameter sets and disjoint takes, never by frame (Wang 2019, section 4).

Whether a parameter set or a take is held out depends on its number alone, so that adding samples or clips never moves
an earlier one from one split to another. Three test sets are kept apart (metrics reference): new parameters with seen
motions, seen parameters with new motions, and both new.
"""

from __future__ import annotations

from dataclasses import dataclass

TRAIN = "train"
UNSEEN_PARAMETERS = "unseen_parameters"
UNSEEN_MOTIONS = "unseen_motions"
UNSEEN_BOTH = "unseen_both"
SPLITS = (TRAIN, UNSEEN_PARAMETERS, UNSEEN_MOTIONS, UNSEEN_BOTH)


@dataclass(frozen=True)
class SplitRule:
    """Every n-th parameter set and every n-th take is held out.

    Attributes:
        parameters_every: Parameter set ``i >= 1`` is held out when ``i % parameters_every == 0``.
        takes_every: Take ``i >= 0`` is held out when ``i % takes_every == takes_every - 1``.
    """

    parameters_every: int
    takes_every: int

    def __post_init__(self) -> None:
        for name in ("parameters_every", "takes_every"):
            if getattr(self, name) < 2:
                raise ValueError(f"split rule: {name} is {getattr(self, name)}, but at least 2 is needed to train")

    def holds_out_parameters(self, phi: int) -> bool:
        """True for a held-out parameter set; the base set 0 is always seen."""
        return phi > 0 and phi % self.parameters_every == 0

    def holds_out_take(self, take_index: int) -> bool:
        """True for a held-out take."""
        return take_index % self.takes_every == self.takes_every - 1

    def split(self, phi: int, take_index: int) -> str:
        """Name of the split of a sequence."""
        new_parameters, new_motion = self.holds_out_parameters(phi), self.holds_out_take(take_index)
        if new_parameters:
            return UNSEEN_BOTH if new_motion else UNSEEN_PARAMETERS
        return UNSEEN_MOTIONS if new_motion else TRAIN

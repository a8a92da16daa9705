"""Splits by disjoint parameter sets, body shapes and takes, never by frame (Wang 2019, section 4).

Whether a parameter set, a body or a take is held out depends on its number alone, so that adding samples or clips never
moves an earlier one from one split to another. Three test sets are kept apart (metrics reference): new parameters with
seen motions, seen parameters with new motions, and both new; with bodies it is the same. Whole labels can be held out
too: a new clip of a known label is easier than a known way of moving in another manner (a style), and that easier than
another movement.
"""

from __future__ import annotations

from dataclasses import dataclass

TRAIN = "train"
UNSEEN_PARAMETERS = "unseen_parameters"
UNSEEN_MOTIONS = "unseen_motions"
UNSEEN_BOTH = "unseen_both"
UNSEEN_STYLES = "unseen_styles"
UNSEEN_LABELS = "unseen_labels"
UNSEEN_BODIES = "unseen_bodies"
UNSEEN_BODIES_AND_MOTIONS = "unseen_bodies_and_motions"
SPLITS = (TRAIN, UNSEEN_PARAMETERS, UNSEEN_MOTIONS, UNSEEN_BOTH, UNSEEN_STYLES, UNSEEN_LABELS)
SPLITS += (UNSEEN_BODIES, UNSEEN_BODIES_AND_MOTIONS)


@dataclass(frozen=True)
class SplitRule:
    """Every n-th parameter set and every n-th take is held out.

    Attributes:
        parameters_every: Parameter set ``i >= 1`` is held out when ``i % parameters_every == 0``.
        takes_every: Take ``i >= 0`` is held out when ``i % takes_every == takes_every - 1``.
        styles: Labels that are held out whole, although others show the same movement in another manner.
        labels: Labels that are held out whole, and nothing like them is seen.
        bodies_every: Body shape ``i >= 1`` is held out when ``i % bodies_every == 0``.
    """

    parameters_every: int
    takes_every: int
    styles: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    bodies_every: int = 4

    def __post_init__(self) -> None:
        for name in ("parameters_every", "takes_every", "bodies_every"):
            if getattr(self, name) < 2:
                raise ValueError(f"split rule: {name} is {getattr(self, name)}, but at least 2 is needed to train")
        both = sorted(set(self.styles) & set(self.labels))
        if both:
            raise ValueError(f"split rule: {', '.join(both)} cannot be both a held-out style and a held-out label")

    def holds_out_parameters(self, phi: int) -> bool:
        """True for a held-out parameter set; the base set 0 is always seen."""
        return phi > 0 and phi % self.parameters_every == 0

    def holds_out_take(self, take_index: int) -> bool:
        """True for a held-out take."""
        return take_index % self.takes_every == self.takes_every - 1

    def holds_out_body(self, number: int) -> bool:
        """True for a held-out body shape; the run's own body, number 0, is always seen."""
        return number > 0 and number % self.bodies_every == 0

    def holds_out_label(self, label: str) -> bool:
        """True for a label none of whose clips is trained on."""
        return label in self.styles or label in self.labels

    def split(self, phi: int, take_index: int, label: str = "", body_index: int = 0) -> str:
        """Name of the split of a sequence; no data plan varies parameters and bodies together."""
        if self.holds_out_label(label):
            return UNSEEN_STYLES if label in self.styles else UNSEEN_LABELS
        new_parameters, new_motion = self.holds_out_parameters(phi), self.holds_out_take(take_index)
        if self.holds_out_body(body_index):
            return UNSEEN_BODIES_AND_MOTIONS if new_motion else UNSEEN_BODIES
        if new_parameters:
            return UNSEEN_BOTH if new_motion else UNSEEN_PARAMETERS
        return UNSEEN_MOTIONS if new_motion else TRAIN

"""Which parts of the body a garment vertex belongs to.

Where the body passes through itself (arm pressed to the torso, thigh on thigh), cloth between the two surfaces cannot
satisfy both. So a vertex belongs to some parts by its skinning weights, and where there is no room it follows these; a
body part is an open piece of the surface that overlaps its neighbours at the joints. Pure NumPy; indices follow the 24
SMPL joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Joints of each part. Collars belong to the trunk: shirts lie on them.
BODY_PARTS: dict[str, tuple[int, ...]] = {
    "trunk": (0, 3, 6, 9, 12, 13, 14, 15),
    "left_thigh": (1,),
    "right_thigh": (2,),
    "left_shank": (4, 7, 10),
    "right_shank": (5, 8, 11),
    "left_upper_arm": (16,),
    "right_upper_arm": (17,),
    "left_forearm": (18, 20, 22),
    "right_forearm": (19, 21, 23),
}
# A skirt hangs around both legs at once: to it they are one body with the trunk. The same holds for a dress.
_LEGS_AS_ONE = ("trunk", "left_thigh", "right_thigh", "left_shank", "right_shank")
JOINED_PARTS: dict[str, tuple[tuple[str, ...], ...]] = {"skirt": (_LEGS_AS_ONE,), "dress": (_LEGS_AS_ONE,)}

HANDS = (20, 21, 22, 23)
"""Joints of the hands, from the wrist."""

MAX_OWNED = 4  # parts a vertex


@dataclass(frozen=True)
class ContactParts:
    """Parts of a body as seen by one garment.

    Attributes:
        faces: Face indices into the body of each part.
        owned: Part indices of each garment vertex, padded with -1, shape [V, 4].
        regions: Which limb each face of the body belongs to, shape [F].
    """

    faces: tuple[np.ndarray, ...]
    owned: np.ndarray
    regions: np.ndarray

    def face_bits(self) -> np.ndarray:
        """The parts of each face of the body as bits, shape [F]."""
        bits = np.zeros(len(self.regions), dtype=np.int32)
        for part, faces in enumerate(self.faces):
            bits[faces] |= 1 << part
        return bits

    def owned_bits(self) -> np.ndarray:
        """The parts of each garment vertex as bits, shape [V]."""
        return np.where(self.owned >= 0, 1 << np.maximum(self.owned, 0), 0).sum(axis=1).astype(np.int32)


def whole_body(face_count: int, vertex_count: int, regions: np.ndarray | None = None) -> ContactParts:
    """Every vertex collides with every face; ``regions`` as in ``ContactParts``, one where None."""
    owned = np.full((vertex_count, MAX_OWNED), -1, dtype=np.int32)
    owned[:, 0] = 0
    regions = np.zeros(face_count, dtype=np.int32) if regions is None else regions
    return ContactParts((np.arange(face_count),), owned, regions)


def body_regions(body_faces: np.ndarray, body_index: np.ndarray, body_weight: np.ndarray) -> np.ndarray:
    """The limb of ``BODY_PARTS`` that has most of the skinning weight of each face, shape [F]."""
    weights = _part_weights(list(BODY_PARTS.values()), body_index, body_weight)
    return np.argmax(weights[body_faces].mean(axis=1), axis=1).astype(np.int32)


def handless(body_faces: np.ndarray, body_index: np.ndarray, body_weight: np.ndarray) -> np.ndarray:
    """Which faces are not of the hands, shape [F].

    Hands are thinner than the way that they swing between two queries, and fingers are hooks: cloth that a hand has
    passed ends up on both of its sides, and is torn. Garments do without colliding with hands.
    """
    hand = _part_weights([HANDS], body_index, body_weight)[:, 0]
    return hand[body_faces].mean(axis=1) < 0.5


def own_parts(
    kind: str,
    body_faces: np.ndarray,
    body_index: np.ndarray,
    body_weight: np.ndarray,
    garment_index: np.ndarray,
    garment_weight: np.ndarray,
    owned_above: float = 0.15,
    face_above: float = 0.35,
) -> ContactParts:
    """Parts by skinning weight.

    Args:
        kind: Garment kind; those in ``JOINED_PARTS`` take several parts as one.
        body_faces: Triangles of the body, shape [F, 3].
        body_index: Joints of each body vertex, shape [B, k].
        body_weight: Their weights, shape [B, k].
        garment_index: Joints of each garment vertex, shape [V, k].
        garment_weight: Their weights, shape [V, k].
        owned_above: A garment vertex owns a part with more than this summed weight, and always the heaviest one.
        face_above: A face belongs to a part with more than this summed weight, and always to the heaviest one.
    """
    groups = _groups(kind)
    body = _part_weights(groups, body_index, body_weight)[body_faces].mean(axis=1)
    garment = _part_weights(groups, garment_index, garment_weight)

    used = np.flatnonzero(_belongs(garment, owned_above).any(axis=0))
    faces = tuple(np.flatnonzero(_belongs(body, face_above)[:, part]) for part in used)
    belongs = _belongs(garment, owned_above)[:, used]
    # Heaviest first, so that the padding of four never drops the part that matters.
    order = np.argsort(-np.where(belongs, garment[:, used], -1.0), axis=1, kind="stable")[:, :MAX_OWNED]
    owned = np.full((len(garment), MAX_OWNED), -1, dtype=np.int32)
    owned[:, : order.shape[1]] = np.where(np.take_along_axis(belongs, order, axis=1), order, -1)
    return ContactParts(faces, owned, body_regions(body_faces, body_index, body_weight))


def worn_parts(
    kinds: Sequence[str],
    layer: np.ndarray,
    body_faces: np.ndarray,
    body_index: np.ndarray,
    body_weight: np.ndarray,
    garment_index: np.ndarray,
    garment_weight: np.ndarray,
) -> ContactParts:
    """Parts of garments worn together, each by the rule of its own kind; what is alike they share.

    Args:
        kinds: Kind of each garment.
        layer: Which of them each vertex belongs to, shape [V].
        body_faces: As for :func:`own_parts`, like all that follow.
    """
    faces: list[np.ndarray] = []
    owned = np.full((len(layer), MAX_OWNED), -1, dtype=np.int32)
    for number, kind in enumerate(kinds):
        mine = layer == number
        parts = own_parts(kind, body_faces, body_index, body_weight, garment_index[mine], garment_weight[mine])
        place = np.zeros(len(parts.faces), dtype=np.int32)
        for part, own in enumerate(parts.faces):
            place[part] = next((k for k, known in enumerate(faces) if np.array_equal(own, known)), len(faces))
            faces += [own] if place[part] == len(faces) else []
        owned[mine] = np.where(parts.owned >= 0, place[parts.owned], -1)
    return ContactParts(tuple(faces), owned, body_regions(body_faces, body_index, body_weight))


def _groups(kind: str) -> list[tuple[int, ...]]:
    joined = JOINED_PARTS.get(kind, ())
    groups = [sum((BODY_PARTS[name] for name in names), ()) for names in joined]
    taken = {name for names in joined for name in names}
    return groups + [joints for name, joints in BODY_PARTS.items() if name not in taken]


def _part_weights(groups: list[tuple[int, ...]], index: np.ndarray, weight: np.ndarray) -> np.ndarray:
    columns = [np.where(np.isin(index, joints), weight, 0.0).sum(axis=1) for joints in groups]
    return np.stack(columns, axis=1)


def _belongs(weights: np.ndarray, above: float) -> np.ndarray:
    heaviest = weights == weights.max(axis=1, keepdims=True)
    return (weights > above) | heaviest

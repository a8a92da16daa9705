"""What garments that hang from the shoulders share: how far they stand off, their neckline, sleeves and armholes.

The fabric lies close to neck and shoulders, which carry it, and only stands off below them. A neckline that is wide, or
straps that are set far out, slide off the shoulder as soon as the body moves and then spoil every figure of the
simulation.
"""

from __future__ import annotations

import numpy as np

from garments.ease import smooth_step
from garments.landmarks import ELBOWS, NECK, PELVIS, SHOULDERS, WRISTS, Landmarks, slice_points
from garments.spec import GarmentSpec
from garments.surface import DenseSurface

SHOULDER_EASE = 0.005
"""Gap of the fabric that rests on neck and shoulders [m]."""

NECK_CLEARANCE = 0.008
"""Distance of the neckline from the neck's own outline when ``neck`` is 0 [m]."""

NECK_DEPTH = 0.06
"""Lowest point of the neckline below the neck joint when ``neck`` is 0 [m]."""

NECK_ROUNDING = 0.04
"""Radius scale of the corner between the neckline's sides and its lowest point [m]."""

ARM_REACH = 0.13
"""Everything nearer than this to the bare arm's bones and beyond the sleeve hem is cut away [m]."""

ARMHOLE_DEPTH, ARMHOLE_SIDE = 0.015, 0.010
"""How far the lowest point of an armhole lies below the armpit, and outside of the fabric on the chest's side [m]."""

BELOW_ARMHOLE = 0.15
"""Height under the armhole in which the arm is cut away [m]; lower down, what is near a hand is the garment's own."""


def trunk_gap(y: np.ndarray, marks: Landmarks, ease: float, sag: float, flare: float = 0.0) -> np.ndarray:
    """Gap of the fabric at heights [m], of any shape: that of the shoulders above, ``ease`` and ``flare`` below."""
    armpit = marks.joints[list(SHOULDERS), 1].mean() - 0.10
    shoulder = min(SHOULDER_EASE + sag, ease)
    gap = shoulder + (ease - shoulder) * smooth_step((armpit + 0.12 - y) / 0.12)
    return gap + flare * np.maximum(armpit - y, 0.0)


def bridged_below_neck(y: np.ndarray, marks: Landmarks) -> np.ndarray:
    """Where hollows are bridged, 0..1: the closing would bridge shoulder and neck too, and widen the neckline."""
    return smooth_step((marks.joints[NECK, 1] - 0.01 - y) / 0.10)


def hem_height(spec: GarmentSpec, marks: Landmarks, usual: float, shortest: float, longest: float) -> float:
    """Height of the hem [m] by the measure ``length``, neck joint to hem, of a garment that ends on the legs.

    Args:
        spec, marks: The garment and the body's landmarks.
        usual: Length where none is given [m].
        shortest, longest: Lengths that this garment can have on this body [m]; beyond them ``ValueError``.
    """
    length = spec.measure("length", usual)
    if not shortest <= length <= longest:
        raise ValueError(
            f"garment '{spec.name}': 'length' {length:.3f} m must put the hem between crotch and ankles, on this body "
            f"{shortest:.3f}..{longest:.3f} m"
        )
    return marks.joints[NECK, 1] - length


def arm_openings(spec: GarmentSpec, marks: Landmarks, ease: float) -> list[Sleeve | Armhole]:
    """Where the left and the right arm come out: sleeves, or armholes where the garment has none.

    Args:
        spec: The garment; kinds without the measure ``sleeve`` have none.
        marks: The body.
        ease: Gap of the fabric at the chest, sag of its triangles included [m].
    """
    if spec.has_sleeves:
        return [Sleeve(spec, *(marks.joints[pair[s]] for pair in (SHOULDERS, ELBOWS, WRISTS))) for s in (0, 1)]
    return [Armhole(spec, marks, side, ease) for side in (1.0, -1.0)]


def cut_at_arms_and_neck(
    surface: DenseSurface, spec: GarmentSpec, marks: Landmarks, arms: list[Sleeve | Armhole]
) -> DenseSurface:
    """The surface without what is beyond its sleeves or armholes and inside its neckline; its largest piece."""
    for arm in arms:
        surface = surface.clipped(arm.beyond(surface.vertices))
    return surface.clipped(_inside_neckline(spec, marks, surface.vertices)).largest_component()


class Sleeve:
    """Where one sleeve ends: a plane across the arm, ``sleeve`` metres from the shoulder along its bones.

    Attributes:
        end: Middle of the opening [m], shape [3].
    """

    def __init__(self, spec: GarmentSpec, shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray) -> None:
        upper, fore = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
        length = spec.measure("sleeve", 0.55 * upper)
        longest = upper + fore - 0.02
        if length > longest:
            raise ValueError(
                f"garment '{spec.name}': 'sleeve' {length:.3f} m passes the wrist, this body allows {longest:.3f} m"
            )
        on_upper = length <= upper
        self.direction = (elbow - shoulder) / upper if on_upper else (wrist - elbow) / fore
        self.end = shoulder + length * self.direction if on_upper else elbow + (length - upper) * self.direction
        # The bare arm: from the sleeve's end along the bones, the hand being as far again as half the forearm.
        fingers = wrist + 0.6 * (wrist - elbow)
        self.bare = [(self.end, elbow), (elbow, fingers)] if on_upper else [(self.end, fingers)]

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """Positive [m] for points of the arm past the sleeve's end, shape [N]."""
        along = (points - self.end) @ self.direction
        away = np.min([_segment_distance(points, start, end) for start, end in self.bare], axis=0)
        return np.minimum(along, ARM_REACH - away)


class Armhole:
    """Where one arm comes out of a garment without sleeves: an upright plane from the strap to under the armpit.

    It leans outwards towards its lower end, so that it leaves the side of the chest where the armpit ends.

    Attributes:
        end: Middle of the opening [m], shape [3].
    """

    def __init__(self, spec: GarmentSpec, marks: Landmarks, side: float, ease: float) -> None:
        """On the left, ``side`` 1, or the right, -1; ``ease`` is the gap at the chest [m]."""
        seam = _shoulder_seam(marks, side)
        top, armpit = seam[seam[:, 1].argmax()], seam[seam[:, 1].argmin()]
        middle = marks.joints[PELVIS, 0]
        low, high = _neck_outline(spec, marks)
        neckline = 0.5 * (high[0] - low[0]) + NECK_CLEARANCE + spec.measure("neck")
        strap, shoulder = spec.measure("strap"), abs(marks.joints[SHOULDERS[0], 0] - middle)
        widest = shoulder - neckline
        if strap > widest:
            raise ValueError(
                f"garment '{spec.name}': 'strap' {strap:.3f} m passes the shoulder, this body and a neckline of this "
                f"width allow {widest:.3f} m"
            )
        upper = np.array([neckline + strap, top[1]])
        lower = np.array([abs(armpit[0] - middle) + ease + ARMHOLE_SIDE, armpit[1] - ARMHOLE_DEPTH])
        lower[0] = max(lower[0], upper[0])
        along = (upper - lower) / np.linalg.norm(upper - lower)
        self._upper, self._outwards, self._middle, self._side = upper, np.array([along[1], -along[0]]), middle, side
        self._lowest = lower[1] - BELOW_ARMHOLE
        centre = 0.5 * (upper + lower)
        self.end = np.array([middle + side * centre[0], centre[1], 0.5 * (top[2] + armpit[2])])

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """Positive [m] for points of the shoulder and the arm outside of the armhole, shape [N]."""
        flat = np.stack([self._side * (points[:, 0] - self._middle), points[:, 1]], axis=1)
        return np.minimum((flat - self._upper) @ self._outwards, points[:, 1] - self._lowest)


def _shoulder_seam(marks: Landmarks, side: float) -> np.ndarray:
    """Body vertices around one shoulder where trunk and arm meet [m], shape [K, 3]."""
    arm = marks.arm_weight[marks.faces].max(axis=1) >= 0.5
    seam = np.intersect1d(marks.faces[arm], marks.faces[~arm])
    points = marks.vertices[seam]
    return points[side * (points[:, 0] - marks.joints[PELVIS, 0]) > 0.0]


def _neck_outline(spec: GarmentSpec, marks: Landmarks) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest (x, z) of the neck just above its base [m]."""
    neck = marks.joints[NECK]
    outline = slice_points(marks.vertices, marks.trunk_faces, neck[1] + 0.02)
    outline = outline[np.abs(outline[:, 0] - neck[0]) < 0.10]
    if len(outline) < 8:
        raise ValueError(f"garment '{spec.name}': this body has no neck to fit a neckline to")
    return outline.min(axis=0), outline.max(axis=0)


def _inside_neckline(spec: GarmentSpec, marks: Landmarks, points: np.ndarray) -> np.ndarray:
    """Positive [m] inside an upright elliptic cylinder around the neck and above the collar bones, shape [N]."""
    low, high = _neck_outline(spec, marks)
    widening = spec.measure("neck")
    axes = 0.5 * (high - low) + NECK_CLEARANCE + widening
    scaled = (points[:, [0, 2]] - 0.5 * (low + high)) / axes
    around = (1.0 - np.linalg.norm(scaled, axis=1)) * axes.min()
    above = points[:, 1] - (marks.joints[NECK, 1] - NECK_DEPTH - widening)
    # Rounded minimum: a sharp one would leave corners in the neckline.
    blend = np.maximum(NECK_ROUNDING - np.abs(around - above), 0.0)
    return np.minimum(around, above) - blend * blend / (4.0 * NECK_ROUNDING)


def _segment_distance(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distances [m] of points [N, 3] from a straight segment, shape [N]."""
    side = end - start
    where = np.clip((points - start) @ side / max(side @ side, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - where[:, None] * side, axis=1)

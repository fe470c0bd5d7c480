"""Guess the code `spatial`: images show several fringes of one period, and nothing numbers them.

The number of fringes on the whole projector is not visible in the images. It is assumed that the
lit part of the image shows all of them. The orders are relative, until a reference is given.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolImage, Stack
from reconstruction.capture.image_features import FrameGroup, ImageFeatures
from reconstruction.decoding import PhaseReference
from reconstruction.patterns import AXES, Axis, PatternSet

SPATIAL = "spatial"
# Least number of fringes in view at which a period is not assumed to be a single fringe.
SEVERAL_FRINGES = 1.5
# A projector with a whole number of fringes shows at most this share of a fringe too much, because
# the frequency is uncertain.
_UNCERTAIN_FRINGE = 0.1
_TURN = 2.0 * np.pi


def is_spatial(groups: Sequence[FrameGroup], features: Sequence[ImageFeatures]) -> bool:
    """Return True if each axis has one phase set with several fringes in view, and no bits."""
    phases = [group for group in groups if group.kind == "phase"]
    has_bits = any(group.kind not in ("phase", "white", "black") for group in groups)
    axes = [group.axis for group in phases]
    if has_bits or not phases or len(set(axes)) < len(axes):
        return False
    return all(cycles_in_view(group, features) >= SEVERAL_FRINGES for group in phases)


def cycles_in_view(group: FrameGroup, features: Sequence[ImageFeatures]) -> float:
    """Return the number of fringes of a phase set in the lit part of the image."""
    image = next(image for image in features if image.file == group.files[0])
    lit = np.flatnonzero(image.lit[group.axis or "column"].any(axis=0))
    return group.frequency * float(np.ptp(lit) + 1) if lit.size else 0.0


def assumed_fringes(group: FrameGroup, features: Sequence[ImageFeatures]) -> int:
    """Return the least whole number of fringes on the projector that explains those in view."""
    return max(int(np.ceil(cycles_in_view(group, features) - _UNCERTAIN_FRINGE)), 1)


def trial_reference(stack: Stack, patterns: PatternSet, lit: BoolImage) -> PhaseReference | None:
    """Return a reference with which relative orders decode; None for other codes than `spatial`.

    It is the lit pixel with the largest distance from the border of the lit area, with the
    coordinate that its phase has in the fringe at its place in this area.

    Parameters
    ----------
    stack : (frame, row, col) DN
    lit : (row, col) bool
    """
    if patterns.code != SPATIAL:
        return None
    inside = ndimage.distance_transform_edt(lit)
    row, col = divmod(int(inside.argmax()), lit.shape[1])
    known = [_coordinate_px(stack, patterns, lit, (row, col), axis) for axis in AXES]
    return PhaseReference(((float(col), float(row), *known),), islands="join")


def _coordinate_px(
    stack: Stack, patterns: PatternSet, lit: BoolImage, place: tuple[int, int], axis: Axis
) -> float:
    if axis not in patterns.axes:
        return 0.0
    period_px, span = patterns.period_along(axis), patterns.step_sets(axis)[0]
    steps = stack[(span, *place)].astype(np.float64)
    phasor = steps @ np.exp(-1j * _TURN * np.array(patterns.shifts(axis, 0)))
    turns = float(np.angle(phasor)) / _TURN % 1.0
    along = np.flatnonzero(lit.any(axis=AXES.index(axis)))
    share = (place[1 - AXES.index(axis)] - along[0] + 0.5) / (np.ptp(along) + 1.0)
    fringes = patterns.length_px(axis) / period_px
    order = np.clip(np.rint(share * fringes - turns), 0, np.ceil(fringes) - 1)
    return float(period_px * (order + turns))

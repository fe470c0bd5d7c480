"""Light of the projector per frame, as continuous 1-D profiles over its pixel coordinate.

Column patterns depend on the projector column u alone and row patterns on the row v alone, so a
frame's light at (u, v) is profile(u) * edge(v) (or profile(v) * edge(u)), where `edge` is the
blurred outline of the image. Profiles include 8-bit levels, response, black level (finite
contrast), the DMD's pixel box and the lens blur; where that grows with the distance from the focal
plane, profiles at several blurs.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import erf

from reconstruction.arrays import FloatImage
from reconstruction.patterns import PatternFrame, PatternSet
from twin.config.models import Patterns, Projector
from twin.optics.defocus import BlurLevels, Defocus

OVERSAMPLING = 16
"""Table nodes per projector pixel; linear interpolation between them errs by < 1e-3 at the edge
of a Gray bit blurred by 0.5 px, and by < 1e-4 on an 18 px fringe."""

MARGIN_PX = 8.0
"""Tables reach this far beyond the image, so that the blurred edge is inside."""


@dataclass(frozen=True)
class LightTable:
    """Profiles along one projector axis.

    Attributes
    ----------
    profiles : (node, frame) float32
        Relative light at best focus, 1 for a full white field; the last column is the outline of
        the image.
    first_px : float
        Projector coordinate of node 0, px; nodes are 1 / OVERSAMPLING px apart.
    frames : (frame,) int
        Index of each profile's frame in the sequence.
    levels : BlurLevels, optional
        Blurs of `defocused`; None when the blur is the same at every distance.
    defocused : (level, node, frame) float32
        `profiles` at each of these blurs.
    """

    profiles: FloatImage
    first_px: float
    frames: tuple[int, ...]
    levels: BlurLevels | None = None
    defocused: FloatImage | None = None


def pattern_set(projector: Projector, patterns: Patterns) -> PatternSet:
    """Return the sequence that projector and decoder share."""
    return PatternSet(projector.width_px, projector.height_px, **patterns.model_dump())


def light_tables(
    projector: Projector, patterns: PatternSet, axial_mm: tuple[float, float] | None = None
) -> dict[str, LightTable]:
    """Return the tables of both axes: "column" (with white and black) and "row".

    Parameters
    ----------
    projector : Projector
    patterns : PatternSet
    axial_mm : (nearest, farthest), optional
        Distances along the projector's axis at which surfaces may lie; needed with an aperture.

    Raises
    ------
    ValueError
        The projector has an aperture, and no distances are given.
    """
    defocus, levels = Defocus.of(projector), None
    if defocus is not None:
        if axial_mm is None:
            raise ValueError("a projector with an aperture needs the scene's axial distances")
        levels = BlurLevels.between(defocus, *axial_mm)
    return {axis: _table(axis, projector, patterns, levels) for axis in ("column", "row")}


def _table(
    axis: str, projector: Projector, patterns: PatternSet, blur_levels: BlurLevels | None
) -> LightTable:
    length = projector.width_px if axis == "column" else projector.height_px
    chosen = [k for k, frame in enumerate(patterns.frames) if along(frame) == axis]
    levels = np.stack([patterns.profile(patterns.frames[k]) for k in chosen], axis=1)
    light = np.concatenate([response(levels, projector), np.ones((length, 1))], axis=1)
    first_px = -0.5 - MARGIN_PX
    nodes_px = np.arange(first_px, length - 0.5 + MARGIN_PX, 1.0 / OVERSAMPLING)
    table = LightTable(
        blur(light, nodes_px, projector.blur_px).astype(np.float32), first_px, tuple(chosen)
    )
    if blur_levels is None:
        return table
    defocused = [blur(light, nodes_px, sigma_px) for sigma_px in blur_levels.blurs_px()]
    return replace(table, levels=blur_levels, defocused=np.stack(defocused).astype(np.float32))


def along(frame: PatternFrame) -> str:
    """Axis whose table holds a frame: uniform frames are kept with the columns."""
    return frame.axis or "column"


def response(levels: NDArray[np.uint8], projector: Projector) -> NDArray[np.float64]:
    """Relative light of 8-bit levels: power law or table on top of the black level 1 / contrast."""
    black = 1.0 / projector.contrast
    relative = levels.astype(np.float64) / 255.0
    if projector.response is None:
        relative = relative**projector.gamma
    else:
        known_at = np.linspace(0.0, 1.0, len(projector.response))
        relative = np.interp(relative, known_at, projector.response)
    return np.asarray(black + (1.0 - black) * relative)


def blur(
    light: NDArray[np.float64], nodes_px: NDArray[np.float64], blur_px: float
) -> NDArray[np.float64]:
    """Convolve pixel values (pixel, frame) with the DMD box and a Gaussian, at the nodes.

    The weight of pixel j at x is the Gaussian's mass over [x - j - 1/2, x - j + 1/2].
    """
    reach = int(np.ceil(0.5 + 6.0 * blur_px))
    pixel = np.rint(nodes_px).astype(int)[:, None] + np.arange(-reach, reach + 1)
    inside = (pixel >= 0) & (pixel < len(light))
    weight = _mass(nodes_px[:, None] - pixel, blur_px) * inside
    row_starts = np.arange(len(nodes_px) + 1) * pixel.shape[1]
    pixel = np.clip(pixel, 0, len(light) - 1)
    weights = csr_array(
        (weight.ravel(), pixel.ravel(), row_starts), shape=(len(nodes_px), len(light))
    )
    return np.asarray(weights @ light)


def _mass(offset_px: NDArray[np.float64], blur_px: float) -> NDArray[np.float64]:
    def below(edge_px: NDArray[np.float64]) -> NDArray[np.float64]:
        # The limit of no blur: a node on the border of two pixels belongs half to each, else the
        # ramp to the node beside it would shift the border by half a node.
        return np.sign(edge_px) if blur_px == 0.0 else erf(edge_px / (np.sqrt(2.0) * blur_px))

    return np.asarray(0.5 * (below(offset_px + 0.5) - below(offset_px - 0.5)))

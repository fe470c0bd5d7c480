"""Light that the flakes in the footprint of each camera pixel reflect, over that of the mean coat.

A flake is a flat facet with the normal m. Its light enters the camera if m is near the half vector
h of the directions to camera and projector. The density k of this light is a function of the
slopes s of m relative to h, in units of the reflected direction: 2 s in the plane of incidence,
2 cos(theta) s across it, with the angle of incidence theta on h. k is the convolution of the two
pupils, seen from the coat as discs, with the normal distribution of the flake's own slopes. With
the share a / A of the footprint that a flake covers, the distribution of normals in the microfacet
BRDF is

    D_pixel = sum over the flakes of (a / A) 4 cos(theta) k / ((n . m) (h . m)^4)

in place of the smooth D of GGX (Jakob et al., Discrete stochastic microfacet models, ACM Trans.
Graph. 33, 115 (2014); footprints of a pixel: Yan et al., same volume, 116). For point pupils the
term of a flake is its Beckmann distribution. The mean of D_pixel over all coats is the mean of
D / (h . m) over k. The result is the ratio of the two; its mean is 1. Fresnel's factor and masking
are those of the smooth coat.

The footprint is the parallelogram of the pixel in material coordinates, from the neighbouring
pixels. A flake on the border of footprints is divided between them by points of equal area.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.compiling import run_over_rows
from twin.optics.flakes import FlakeProcess, compiled, nested
from twin.optics.pupil_cone import Cone

# Points of equal area by which a flake is divided between pixels: the pixels' errors are 1.5 % of
# the contrast for flakes of 15 um and pixels of 50 um.
_POINTS = 128


# Parts of `PixelMaps.fields`.
_X, _Y, _COLUMN, _ROW, _NORMAL, _POINT, _FIELDS = 0, 1, 2, 3, 4, 7, 10


class PixelMaps(NamedTuple):
    """Geometry at the centre of each camera pixel, (row, col, ...) float32.

    Attributes
    ----------
    valid : (row, col) bool; True where the pixel shows the coat
    fields : (row, col, 10); material coordinates X and Y, mm; projector column and row, px; unit
        normal; world position, mm
    to_eye, to_light : (row, col, xyz); unit vectors to camera and projector, in the medium around
        the coat
    widening : (row, col, 2); width of `Cone` at the pixel over that of its table, in the plane of
        incidence and across it
    """

    valid: BoolImage
    fields: FloatImage
    to_eye: FloatImage
    to_light: FloatImage
    widening: FloatImage

    @property
    def normals(self) -> FloatImage:
        """Unit normals of the coat, (row, col, xyz)."""
        return self.fields[..., _NORMAL : _NORMAL + 3]


class GlintMaps(NamedTuple):
    """Light of the flakes of each pixel.

    Attributes
    ----------
    ratio : (row, col); light of the flakes over that of the smooth distribution of normals
    projector_px : (row, col, 2); mean projector column and row of this light
    valid : (row, col) bool; True where the footprint of the pixel is known; elsewhere the ratio is
        1
    """

    ratio: FloatArray
    projector_px: FloatArray
    valid: BoolImage


class _Optics(NamedTuple):
    density: FloatArray
    reach: float
    samples: FloatArray
    points: FloatArray
    alpha: float
    share: float


def glint_maps(process: FlakeProcess, share: float, cone: Cone, maps: PixelMaps) -> GlintMaps:
    """Return the light of the flakes in the footprint of every pixel.

    Parameters
    ----------
    share : sum of the flakes' areas over the area of the coat
    """
    shape = maps.valid.shape
    projector_px = maps.fields[..., _COLUMN : _ROW + 1].astype(np.float64)
    result = GlintMaps(np.ones(shape), projector_px, np.zeros(shape, np.bool_))
    optics = _Optics(cone.density, cone.reach, cone.samples, _disc_points(), process.alpha, share)

    def fill(first: int, end: int) -> None:
        steps = np.zeros((end - first, shape[1], 2, _FIELDS))
        _differences((first, end), maps, steps, result.valid)
        known = result.valid[first:end]
        if not known.any():
            return
        places = maps.fields[first:end][known][:, : _Y + 1].astype(np.float64)
        half = 0.5 * np.abs(steps[known][..., : _Y + 1]).sum(axis=1)
        (x_low, y_low), (x_high, y_high) = (places - half).min(axis=0), (places + half).max(axis=0)
        flakes = process.within((x_low, x_high, y_low, y_high))
        _fill_ratios(first, maps, steps, (flakes, optics), result)

    run_over_rows(fill, shape[0])
    return result


def _disc_points() -> FloatArray:
    """Return points of equal area on the unit disc, (point, xy): a spiral (Vogel 1979)."""
    index = np.arange(_POINTS)
    angle, radius = index * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt((index + 0.5) / _POINTS)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return np.asarray(points - points.mean(axis=0))


@nested
def _square_gap(fields: Any, a: Any, b: Any) -> Any:
    """Return the squared distance of the surface points of two pixels, mm^2."""
    square = 0.0
    for k in range(_POINT, _FIELDS):
        gap = float(fields[b[0], b[1], k]) - float(fields[a[0], a[1], k])
        square += gap * gap
    return square


@nested
def _neighbours(valid: Any, fields: Any, row: Any, col: Any, axis: Any) -> Any:
    """Return the two pixels whose difference is the step of the fields at a pixel along one axis.

    They are the neighbours. A neighbour without a surface, or one that is more than twice as far as
    the other, beyond an edge, is replaced by the pixel itself.
    """
    here, down = (row, col), 1 - axis
    before, after = (row - down, col - axis), (row + down, col + axis)
    has_before = before[0] >= 0 and before[1] >= 0 and valid[before]
    has_after = after[0] < valid.shape[0] and after[1] < valid.shape[1] and valid[after]
    if has_before and has_after:
        back, forth = _square_gap(fields, before, here), _square_gap(fields, here, after)
        has_before, has_after = back <= 4.0 * forth, forth <= 4.0 * back
    return (before if has_before else here), (after if has_after else here)


@compiled
def _differences(rows: Any, maps: Any, steps: Any, known: Any) -> None:
    """Fill the steps of all fields per pixel along the columns and rows of the image."""
    valid, fields = maps.valid, maps.fields
    for row in range(rows[0], rows[1]):
        for col in range(valid.shape[1]):
            if not valid[row, col]:
                continue
            known[row, col] = True
            for axis in range(2):  # 0: from row to row
                a, b = _neighbours(valid, fields, row, col, axis)
                count = (b[0] - a[0]) + (b[1] - a[1])
                known[row, col] = known[row, col] and count > 0
                for k in range(_FIELDS):
                    gap = float(fields[b[0], b[1], k]) - float(fields[a[0], a[1], k])
                    steps[row - rows[0], col, axis, k] = gap / max(count, 1)


@nested
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@nested
def _sum(a: Any, k: Any, b: Any) -> Any:
    return (a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2])


@nested
def _unit(a: Any) -> Any:
    scale = 1.0 / math.sqrt(_dot(a, a))
    return (a[0] * scale, a[1] * scale, a[2] * scale)


@nested
def _cross(a: Any, b: Any) -> Any:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@nested
def _vector(values: Any, k: Any) -> Any:
    return (float(values[k]), float(values[k + 1]), float(values[k + 2]))


@nested
def _overlap(centre: Any, radius: Any, inverse: Any, points: Any) -> Any:
    """Return the share of a flake in the pixel and the mean u and v of this share, in pixels.

    Parameters
    ----------
    centre : u and v of the flake, relative to the centre of the pixel
    inverse : derivatives of u by X, u by Y, v by X, v by Y, 1/mm
    """
    (u, v), (ux, uy, vx, vy) = centre, inverse
    reach_u, reach_v = radius * math.sqrt(ux * ux + uy * uy), radius * math.sqrt(vx * vx + vy * vy)
    if abs(u) <= 0.5 - reach_u and abs(v) <= 0.5 - reach_v:
        return 1.0, u, v
    count, sum_u, sum_v = 0, 0.0, 0.0
    for k in range(points.shape[0]):
        x, y = radius * points[k, 0], radius * points[k, 1]
        at_u, at_v = u + ux * x + uy * y, v + vx * x + vy * y
        if -0.5 <= at_u < 0.5 and -0.5 <= at_v < 0.5:
            count, sum_u, sum_v = count + 1, sum_u + at_u, sum_v + at_v
    return count / points.shape[0], sum_u / max(count, 1), sum_v / max(count, 1)


@nested
def _reflected(frame: Any, slopes: Any, view: Any, optics: Any) -> Any:
    """Return 4 cos(theta) k / ((n . m) (h . m)^4) of a flake; 0 if no light enters the camera.

    Parameters
    ----------
    frame : normal of the coat, and the direction of X on the coat, not normalised
    view : result of `_view`
    """
    normal, (half, cosine, widths, axes) = _unit(frame[0]), view
    along_x = _unit(_sum(frame[1], -_dot(frame[1], normal), normal))
    along_y = _cross(normal, along_x)
    facet = _sum(_sum(normal, -slopes[0], along_x), -slopes[1], along_y)
    steepness = math.sqrt(1.0 + slopes[0] * slopes[0] + slopes[1] * slopes[1])
    near = _dot(half, facet) / steepness
    if near <= 0.5:
        return 0.0
    gap = _sum((-half[0], -half[1], -half[2]), 1.0 / (steepness * near), facet)
    x, y = 2.0 * _dot(gap, axes[0]) / widths[0], 2.0 * cosine * _dot(gap, axes[1]) / widths[1]
    node = math.sqrt(x * x + y * y) / optics.reach * (optics.density.size - 1)
    if node >= optics.density.size - 1:
        return 0.0
    low = int(node)
    density = optics.density[low] + (node - low) * (optics.density[low + 1] - optics.density[low])
    return 4.0 * cosine * density * steepness / (widths[0] * widths[1] * near**4)


@nested
def _view(to_eye: Any, to_light: Any, widths: Any) -> Any:
    """Return half vector, cosine of the angle of incidence on it, widths of the cone, and its axes.

    The axes are perpendicular to the half vector; the first is in the plane of incidence.
    """
    half = _unit(_sum(to_eye, 1.0, to_light))
    across = _cross(to_light, to_eye)
    if _dot(across, across) < 1e-9:
        across = _cross((0.0, 1.0, 0.0) if abs(half[1]) < 0.9 else (1.0, 0.0, 0.0), half)
    across = _unit(across)
    return half, _dot(half, to_light), widths, (_cross(across, half), across)


@nested
def _smooth(normal: Any, view: Any, optics: Any) -> Any:
    """Return the mean of the GGX distribution of normals over the cone, 1/sr."""
    (half, incidence, widths, axes), square = view, optics.alpha * optics.alpha
    total = 0.0
    for k in range(optics.samples.shape[0]):
        x = 0.5 * widths[0] * optics.samples[k, 0]
        y = 0.5 * widths[1] * optics.samples[k, 1] / incidence
        facet = _sum(_sum(half, x, axes[0]), y, axes[1])
        far = math.sqrt(1.0 + x * x + y * y)
        cosine = _dot(facet, normal) / far
        if cosine > 0.0:
            slope = cosine * cosine * (square - 1.0) + 1.0
            total += optics.samples[k, 2] * far * square / (math.pi * slope * slope)
    return total


@nested
def _light_of_pixel(here: Any, step: Any, view: Any, flakes: Any, optics: Any) -> Any:
    """Return the sum over the flakes of area times `_reflected`, per area, and its mean u and v.

    Parameters
    ----------
    here, step : fields of the pixel, and their steps from row to row and from column to column
    view : result of `_view`
    """
    xu, xv, yu, yv = step[1, _X], step[0, _X], step[1, _Y], step[0, _Y]
    area = xu * yv - xv * yu
    inverse = (yv / area, -xv / area, -yu / area, xu / area)
    along_x = _sum((0.0, 0.0, 0.0), inverse[0], _vector(step[1], _POINT))
    along_x = _sum(along_x, inverse[2], _vector(step[0], _POINT))
    reach_x = 0.5 * (abs(xu) + abs(xv)) + flakes.largest_mm
    reach_y = 0.5 * (abs(yu) + abs(yv)) + flakes.largest_mm
    x, y, per_cell = float(here[_X]), float(here[_Y]), 1.0 / flakes.cell_mm
    left, right = math.floor((x - reach_x) * per_cell), math.floor((x + reach_x) * per_cell)
    low, high = math.floor((y - reach_y) * per_cell), math.floor((y + reach_y) * per_cell)
    reach_u = math.sqrt(inverse[0] ** 2 + inverse[1] ** 2)
    reach_v = math.sqrt(inverse[2] ** 2 + inverse[3] ** 2)
    total, sum_u, sum_v = 0.0, 0.0, 0.0
    for cell_row in range(low - flakes.low[1], high - flakes.low[1] + 1):
        cell = cell_row * flakes.cols - flakes.low[0]
        for k in range(flakes.first[cell + left], flakes.first[cell + right + 1]):
            flake = flakes.flakes[k]
            dx, dy, radius = flake[0] - x, flake[1] - y, flake[2]
            u, v = inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy
            if abs(u) >= 0.5 + radius * reach_u or abs(v) >= 0.5 + radius * reach_v:
                continue
            normal = _sum(_vector(here, _NORMAL), u, _vector(step[1], _NORMAL))
            normal = _sum(normal, v, _vector(step[0], _NORMAL))
            light = _reflected((normal, along_x), (flake[3], flake[4]), view, optics)
            if light == 0.0:
                continue
            share, mean_u, mean_v = _overlap((u, v), radius, inverse, optics.points)
            light *= share * math.pi * radius * radius
            total, sum_u, sum_v = total + light, sum_u + light * mean_u, sum_v + light * mean_v
    scale = 1.0 / total if total > 0.0 else 0.0
    return total / abs(area), sum_u * scale, sum_v * scale


@compiled
def _fill_ratios(first: Any, maps: Any, steps: Any, lit: Any, result: Any) -> None:
    """Fill the ratios and projector coordinates of the rows of `steps`, which begin at `first`.

    Parameters
    ----------
    lit : `Flakes` and `_Optics`
    """
    flakes, optics = lit
    for line in range(steps.shape[0]):
        row = first + line
        for col in range(steps.shape[1]):
            if not result.valid[row, col]:
                continue
            here, step = maps.fields[row, col], steps[line, col]
            to_eye, to_light = (
                _vector(maps.to_eye[row, col], 0),
                _vector(maps.to_light[row, col], 0),
            )
            widths = (float(maps.widening[row, col, 0]), float(maps.widening[row, col, 1]))
            view = _view(to_eye, to_light, widths)
            smooth = _smooth(_vector(here, _NORMAL), view, optics)
            light, u, v = _light_of_pixel(here, step, view, flakes, optics)
            if smooth > 0.0:
                result.ratio[row, col] = light / (optics.share * smooth)
            for k in range(2):
                shift = u * step[1, _COLUMN + k] + v * step[0, _COLUMN + k]
                result.projector_px[row, col, k] += shift

"""Build the elastic layer of a configured slab in both layouts, its preload and its face's nodes.

World frame, mm: the undeformed coated face is z = 0 and the specimen is pressed from below.
- `opposite_face`: the specimen touches the clear face at z = -thickness; the slab spans its rim.
- `contact_face`: the specimen touches the coat; the gel above the coat is bonded to a window at
  z = +thickness.

Between the solver's cells the touched face is interpolated: smoothly where it is free, and with the
specimen's shape in the contact. There are no ripples at the edge of the contact, where curvature or
slope are discontinuous.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.interpolate import Akima1DInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Press
from twin.mechanics.errors import PressError
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.transfer import CoatFilm
from twin.shape import Shape

AnyLayer = FreeSlab | BondedLayer

# Least distance from contact to window edge over thickness of a bonded layer: the contacts in the
# neighbouring periods then displace the surface by 1 um at most (measured on our prototype).
WINDOW_MARGIN = 3.0
# The numbers of cells are multiples of this, because the solver coarsens twice by four.
_CELLS = 16
_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Preload:
    """Uniform pressures over modulus on the touched and the coated face, positive along +z.

    They are the back pressure and the weight, which act before the specimen touches.
    """

    touched: float = 0.0
    coated: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.touched or self.coated)

    def deflection(self, layer: AnyLayer) -> FloatArray:
        """Return the touched face's deflection under the preload (row, col), mm."""
        uniform = np.ones((layer.rows, layer.cols))
        if isinstance(layer, BondedLayer) or not self:
            return np.zeros_like(uniform)
        # Reciprocity (Maxwell, Betti): the touched face deflects under a load on the coated face
        # as the coated face does under the same load on the touched face.
        own, opposite = layer.deflect(uniform), layer.deflect_opposite(uniform)
        return self.touched * own + self.coated * opposite


def preload_of(elastomer: Elastomer, load: Press, modulus_kpa: float) -> Preload:
    """Return back pressure and weight of a free slab as pressures over modulus.

    The weight of a gel bonded to a window is neglected: it displaces the surface by
    rho g h^2 / (2 M), some nanometres (M: oedometer modulus).

    Raises
    ------
    PressError : back pressure on a bonded layer, or weight without a density
    """
    if elastomer.layout == "contact_face":
        if load.back_pressure_kpa:
            raise PressError(
                "press.back_pressure_kpa: needs a free coated face; "
                "remove it, or set elastomer.layout = 'opposite_face'"
            )
        return Preload()
    # Half of the weight acts on each face, which bends the slab as the body force does. The
    # difference in thinning is some nanometres.
    weight = weight_kpa(elastomer, load) / 2
    return Preload(weight / modulus_kpa, (weight - load.back_pressure_kpa) / modulus_kpa)


def build_layer(elastomer: Elastomer, load: Press, shape: Shape, modulus_kpa: float) -> AnyLayer:
    """Return the layer of an elastomer on the solver's grid for a specimen of a given shape."""
    lengths = grid_lengths_mm(elastomer, shape)
    cols, rows = (
        _CELLS * int(fft.next_fast_len(_count(length, _CELLS * load.solver_pitch_mm), real=True))
        for length in lengths
    )
    return _layer(elastomer, rows, cols, lengths, modulus_kpa)


def grid_lengths_mm(elastomer: Elastomer, shape: Shape) -> tuple[float, float]:
    """Return the lengths of the solver's grid along x and y, mm."""
    if elastomer.layout == "contact_face":
        return _window_mm(elastomer, shape)
    return elastomer.length_x_mm, elastomer.length_y_mm


def layer_on(
    elastomer: Elastomer, x_mm: FloatArray, y_mm: FloatArray, modulus_kpa: float
) -> AnyLayer:
    """Return the layer on given cells: those of a press that is already solved.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) float, mm; cell centres
    """
    lengths = float(np.ptp(x_mm)), float(np.ptp(y_mm))
    whole = lengths[0] * x_mm.size / (x_mm.size - 1), lengths[1] * y_mm.size / (y_mm.size - 1)
    return _layer(elastomer, y_mm.size, x_mm.size, whole, modulus_kpa)


def cell_centres(length_mm: float, load: Press) -> FloatArray:
    """Return the solver's cell centres (n,), mm, along one axis, a pitch or less apart."""
    count = int(np.ceil(length_mm / load.solver_pitch_mm - 1e-9))
    half = length_mm / 2
    return np.linspace(-half, half, 2 * count + 1)[1::2]


def face_nodes(length_mm: float, load: Press) -> FloatArray:
    """Return the nodes of the coated face along one axis, (n,), mm, both ends included."""
    intervals = int(fft.next_fast_len(_count(length_mm, load.relief_pitch_mm), real=True))
    return np.linspace(-length_mm / 2, length_mm / 2, intervals + 1)


def _layer(
    elastomer: Elastomer, rows: int, cols: int, lengths: tuple[float, float], modulus_kpa: float
) -> AnyLayer:
    kind = FreeSlab if elastomer.layout == "opposite_face" else BondedLayer
    return kind(
        rows=rows,
        cols=cols,
        length_x_mm=lengths[0],
        length_y_mm=lengths[1],
        thickness_mm=elastomer.thickness_mm,
        poisson_ratio=elastomer.poisson_ratio,
        film=coat_film(elastomer, modulus_kpa),
    )


def coat_film(elastomer: Elastomer, modulus_kpa: float) -> CoatFilm | None:
    """Return the film relative to a slab of the given modulus; None if there is no film."""
    film = elastomer.film
    if film is None:
        return None
    shear = film.young_modulus_kpa / (1 + film.poisson_ratio)
    return CoatFilm(
        share=film.thickness_mm / elastomer.thickness_mm,
        shear_ratio=shear * (1 + elastomer.poisson_ratio) / modulus_kpa,
        poisson_ratio=film.poisson_ratio,
    )


def _window_mm(elastomer: Elastomer, shape: Shape) -> tuple[float, float]:
    """Return the lengths of the centred periodic window along x and y, mm.

    Each is the length of the pad, or that of the specimen with its margin if this is larger.
    """
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    margin = WINDOW_MARGIN * elastomer.thickness_mm
    return (
        max(elastomer.length_x_mm, 2 * (max(-x_low, x_high) + margin)),
        max(elastomer.length_y_mm, 2 * (max(-y_low, y_high) + margin)),
    )


def _count(length_mm: float, pitch_mm: float) -> int:
    return int(np.ceil(length_mm / pitch_mm - 1e-9))


def weight_kpa(elastomer: Elastomer, load: Press) -> float:
    """Return the slab's weight per area along +z, kPa; 0 without `gravity_deg`.

    Density x acceleration x thickness: kg/m^3 m/s^2 mm = 1e-6 kPa.
    """
    if load.gravity_deg is None:
        return 0.0
    if elastomer.density_kg_m3 is None:
        raise PressError("elastomer.density_kg_m3: missing; press.gravity_deg needs it")
    along = -_GRAVITY_M_S2 * float(np.cos(np.deg2rad(load.gravity_deg)))
    return 1e-6 * elastomer.density_kg_m3 * along * elastomer.thickness_mm


# Number of cells beyond the nodes: the interpolation needs at least two on either side.
_BEYOND = 4


def touched_at_nodes(
    deflection_mm: FloatArray,
    cells_mm: tuple[FloatArray, FloatArray],
    nodes_mm: tuple[FloatArray, FloatArray],
    indented_mm: FloatArray,
) -> FloatArray:
    """Interpolate the touched face's deflection from cell centres to nodes.

    Parameters
    ----------
    deflection_mm : (row, col) float, mm; at the cell centres, along the press
    cells_mm : ((row,), (col,)) float, mm; world y and x of the cell centres
    nodes_mm : ((node row,), (node col,)) float, mm; world y and x of the nodes, within the cells
    indented_mm : (node row, node col) float, mm; depth minus the specimen's height at the nodes,
        -inf where there is no specimen. The result is nowhere smaller than this.

    Returns
    -------
    (node row, node col) float, mm; deflection at the nodes

    Notes
    -----
    Modified Akima interpolation along one axis after the other. It is local: an edge affects two
    cells at most, whereas a cubic spline has ripples across the whole face.
    """
    refined = deflection_mm
    for axis, (cells, nodes) in enumerate(zip(cells_mm, nodes_mm, strict=True)):
        first, last = np.searchsorted(cells, (nodes[0], nodes[-1]))
        near = np.arange(max(first - _BEYOND, 0), min(last + _BEYOND, cells.size))
        part = refined.take(near, axis=axis)
        refined = Akima1DInterpolator(cells[near], part, axis=axis, method="makima")(nodes)
    return np.asarray(np.maximum(refined, indented_mm))


def wrapped(
    deflection_mm: FloatArray, cells_mm: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Continue a periodic field by 4 cells beyond each side of its window.

    Returns the wider field and its cell centres along y and x; nodes on the window's edge are then
    between cell centres.
    """
    wide = np.pad(deflection_mm, _BEYOND, mode="wrap")
    return wide, (widened(cells_mm[0]), widened(cells_mm[1]))


def widened(cells_mm: FloatArray) -> FloatArray:
    """Return equidistant cell centres, mm, with 4 further cells at both ends."""
    step = cells_mm[1] - cells_mm[0]
    return np.asarray(cells_mm[0] + step * np.arange(-_BEYOND, cells_mm.size + _BEYOND))


def mirrored(deflection_mm: FloatArray) -> FloatArray:
    """Continue a field (row, col) that is odd about the rim by 4 cells beyond each side.

    The rim is half a cell beyond the outermost cell centres.
    """
    wide = np.pad(deflection_mm, _BEYOND, mode="symmetric")
    wide[:_BEYOND] *= -1
    wide[-_BEYOND:] *= -1
    wide[:, :_BEYOND] *= -1
    wide[:, -_BEYOND:] *= -1
    return wide

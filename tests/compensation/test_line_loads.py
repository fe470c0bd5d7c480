"""Line loads of edges: their size, the length of the lift-off, and faces between edges."""

import numpy as np
import pytest
from scipy import ndimage

from reconstruction.arrays import FloatArray
from reconstruction.compensation.line_loads import LineLoads, PressureMap, line_loads
from reconstruction.compensation.relief import SheetOpening, relief_on_frame
from reconstruction.compensation.sheet_layer import SheetLayer

AIR_KPA, TENSION_KPA_MM, LOAD_KPA_MM, BLUR_MM = 2.5, 50.0, 30.0, 0.2
FRAME = SheetOpening(8.0, 8.0)
LAYER = SheetLayer(FRAME, 0.15, 413.0, back_pressure_kpa=AIR_KPA)
PITCH_MM, CELLS = 0.1, 80


def loads_of(pressure_kpa: FloatArray, noise_kpa: float = 0.01) -> LineLoads:
    """Return the line loads in a map under equal tension, at the undeformed thickness."""
    places = (np.arange(CELLS) + 0.5) * PITCH_MM - 4.0
    x, y = np.meshgrid(places, places)
    points = np.stack((x, y, 0 * x), axis=-1).reshape(-1, 3)
    relief = relief_on_frame(points, np.full(len(points), 1e-4), FRAME, (CELLS, CELLS))
    tension = np.full(pressure_kpa.shape, TENSION_KPA_MM)
    local = np.full(pressure_kpa.shape, LAYER.thickness_mm)
    return line_loads(PressureMap(pressure_kpa, noise_kpa, BLUR_MM, tension, local), relief, LAYER)


def blurred(pressure_kpa: FloatArray) -> FloatArray:
    return np.asarray(ndimage.gaussian_filter(pressure_kpa, BLUR_MM / PITCH_MM))


def edge_of_a_face() -> FloatArray:
    """Return the pressure of a flat face at x < 0 that ends at an edge, blurred."""
    pressure = np.zeros((CELLS, CELLS))
    pressure[:, : CELLS // 2] = AIR_KPA
    pressure[:, CELLS // 2] += LOAD_KPA_MM / PITCH_MM
    return blurred(pressure)


def test_a_sheet_lifts_off_over_the_length_of_the_parabola() -> None:
    """L = sqrt(F l / p), with the bending stiffness E h^3 / 9 of the undeformed sheet."""
    loads = loads_of(edge_of_a_face())
    bending_mm = np.sqrt(0.15**2 / 6 + 413.0 * 0.15**3 / 9 / TENSION_KPA_MM)
    length_mm = np.sqrt(LOAD_KPA_MM * bending_mm / AIR_KPA)
    assert loads.reach_mm.max() == pytest.approx(length_mm, rel=0.05)
    (row,) = loads.lifted()[CELLS // 2 : CELLS // 2 + 1]
    assert PITCH_MM * row[: CELLS // 2].sum() == pytest.approx(length_mm, abs=3 * PITCH_MM)
    assert not row[: CELLS // 4].any()


def test_a_smooth_contact_and_noise_have_no_line_load() -> None:
    """The border of a wide contact is no edge, and the peaks of the noise are none."""
    x, y = np.meshgrid(*2 * [np.arange(CELLS) - CELLS / 2])
    pressure = blurred(np.where(np.hypot(x, y) < 25, 10.0, 0.0))
    noise = 0.3 * np.random.default_rng(1).normal(size=pressure.shape)
    assert not loads_of(pressure).lifted().any()
    assert not loads_of(pressure + noise, 0.3).lifted().any()


def test_a_face_is_enclosed_by_edges_on_all_sides_only() -> None:
    reach = np.zeros((9, 12))
    reach[1, 2:10] = reach[7, 2:10] = 0.3
    assert not LineLoads(reach, (0.1, 0.1)).enclosed()[4].any()
    reach[1:8, 2] = reach[1:8, 9] = 0.3
    enclosed = LineLoads(reach, (0.1, 0.1)).enclosed()
    assert enclosed[4].tolist() == [2 <= col <= 9 for col in range(12)]
    assert not enclosed[0].any()

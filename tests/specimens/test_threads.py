"""Screw threads and fasteners: closed forms of their volumes, order of convergence, standards."""

from math import pi, sqrt, tan

import numpy as np
import pytest
from pydantic import ValidationError

from twin.specimens import height_above_lowest, shape_of
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.t_bolt import TBolt
from twin.specimens.solids import box, common
from twin.specimens.threads import minor_diameter_mm, screw


def thread_area_mm2(major_mm: float, pitch_mm: float) -> float:
    """Return the mean area of the section across the axis, mm^2.

    All sections across the axis are equal except for a rotation: this area times the length is the
    volume. Integral of pi r^2 over one pitch: two cylinders and two cone frustums.
    """
    crest, root = major_mm / 2, minor_diameter_mm(major_mm, pitch_mm) / 2
    flank = (crest**2 + crest * root + root**2) / 3
    return float(pi * (root**2 / 4 + crest**2 / 8 + flank * 5 / 8))


def hexagon_mm2(across_flats_mm: float) -> float:
    return sqrt(3) / 2 * across_flats_mm**2


def test_minor_diameter_is_the_standards() -> None:
    """ISO 724 tabulates D1: 4.917 for M6, 4.134 for M5."""
    assert minor_diameter_mm(6.0, 1.0) == pytest.approx(4.917, abs=5e-4)
    assert minor_diameter_mm(5.0, 0.8) == pytest.approx(4.134, abs=5e-4)


def test_thread_volume_converges_to_the_closed_form_with_second_order() -> None:
    """Sections across a helical thread are all alike: volume = mean area x length.

    A polygon of n sides lacks (2 pi / n)^2 / 6 of its circle's area, so that each doubling of n
    reduces the error to 0.25 x.
    """
    length, exact = 5.0, thread_area_mm2(6.0, 1.0) * 5.0
    slab = box((-9.0, -9.0, 0.0), (9.0, 9.0, length))
    errors = [
        1 - common([screw(6.0, 1.0, 0.0, length, sections), slab]).volume / exact
        for sections in (24, 48, 96)
    ]
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (errors[0], errors[2]) == pytest.approx(((2 * pi / 24) ** 2 / 6, 7e-4), rel=0.2)
    np.testing.assert_allclose(order, 2, atol=0.3)


def test_thread_is_right_handed_with_its_pitch_and_flank_angle() -> None:
    """A right-handed thread rises by pitch / 4 on the quarter turn from +x to +y; its flanks
    are inclined by 30 degrees to the radius (60 degrees to each other)."""
    thread = screw(6.0, 1.2, -4.0, 4.0, sections=96)
    x, y, z = thread.vertices.T

    def profile(turned_deg: float) -> np.ndarray:
        near = np.hypot(x, y) > 1.0
        angle = np.rad2deg(np.arctan2(y, x))
        here = near & (np.abs(angle - turned_deg) < 1e-6)
        return np.stack((np.hypot(x, y)[here], z[here]))[:, z[here].argsort()]

    (radius, height), (_, quarter) = profile(0.0), profile(90.0)
    np.testing.assert_allclose(height[4:] - height[:-4], 1.2, atol=1e-12)
    np.testing.assert_allclose((quarter[:8] - height[:8]) % 1.2, 0.3, atol=1e-12)
    rise = np.hypot(*np.diff([radius, height], axis=1))
    flank = np.abs(np.diff(radius)) > 0.1
    slope_deg = np.rad2deg(np.arccos(np.abs(np.diff(radius)) / rise))
    np.testing.assert_allclose(slope_deg[flank], 30, atol=1e-9)
    assert radius.max() == pytest.approx(3.0)


def test_nut_without_chamfer_is_hexagon_less_thread() -> None:
    nut = Nut(chamfer_mm=0, countersink_mm=0)
    exact = (hexagon_mm2(10.0) - thread_area_mm2(6.0, 1.0)) * nut.height_mm
    assert shape_of(nut).mesh(0.0).volume == pytest.approx(exact, rel=2e-4)


def test_chamfer_and_countersink_take_what_they_should() -> None:
    """The volume of the countersunk rings is between those of a plain and a threaded cone. The
    chamfer is checked by height: its cone descends with tan 30 deg beyond the bearing face."""
    nut = Nut()
    plain = shape_of(nut.model_copy(update={"countersink_mm": 0.0})).mesh(0.0).volume
    outer, hole = nut.countersink_mm / 2, minor_diameter_mm(6.0, 1.0) / 2
    depth = (outer - hole) / sqrt(3)
    cone = pi * depth / 3 * (outer**2 + outer * hole + hole**2) - pi * hole**2 * depth
    taken = plain - shape_of(nut).mesh(0.0).volume
    # The thread has already taken up to a pitch's worth of that ring on each face.
    assert 0.2 * 2 * cone < taken < 2 * cone
    corner = 10 / sqrt(3) - 0.05
    fall = height_above_lowest(nut, np.array([corner]), np.array([0.0]))[0, 0]
    assert fall == pytest.approx((corner - nut.face_radius_mm) * tan(pi / 6), abs=2e-3)


def test_nut_faces_the_elastomer_flat_round_an_open_hole() -> None:
    height = height_above_lowest(Nut(), np.array([0.0, 2.0, 3.9]), np.array([0.0]))[0]
    assert np.isinf(height[:2]).all()
    assert height[2] == pytest.approx(0, abs=1e-9)


def test_bolt_volume_is_the_sum_of_its_parts() -> None:
    """Head (two rounded corners), square neck, shank; the chamfered tip takes less than 2 %."""
    bolt = TBolt()
    rounded = (bolt.head_width_mm / 2) ** 2 * (2 - pi / 2)
    head = (bolt.head_length_mm * bolt.head_width_mm - rounded) * bolt.head_height_mm
    neck = bolt.head_width_mm**2 * bolt.neck_mm
    shank = thread_area_mm2(5.0, 0.8) * bolt.shank_mm
    volume = shape_of(bolt).mesh(0.0).volume
    assert head + neck + 0.98 * shank < volume < head + neck + shank


@pytest.mark.parametrize(
    ("facing", "extents"),
    [("side", (17.0, 10.0, 5.8)), ("tip", (5.8, 10.0, 17.0)), ("head", (5.8, 10.0, 17.0))],
)
def test_bolt_turns_the_chosen_side_up(facing: str, extents: tuple[float, float, float]) -> None:
    bolt = TBolt.model_validate({"facing": facing})
    np.testing.assert_allclose(shape_of(bolt).mesh(0.0).extents, extents, atol=1e-6)
    grid = np.linspace(-6, 6, 121)
    touching = (height_above_lowest(bolt, grid, grid) < 0.1).sum() * 0.01
    flat_mm2 = {"side": 5.8 * 5.5, "tip": 13.0, "head": 50.0}[facing]
    assert 0.5 * flat_mm2 < touching < 1.2 * flat_mm2


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"pitch_mm": 3.0}, "pitch_mm: found 3, allowed at most 1.5"),
        ({"thread_mm": 9.5}, "thread_mm: found 9.5, allowed at most 9"),
        ({"countersink_mm": 9.9}, "countersink_mm: found 9.9, allowed at most 9.25"),
        ({"chamfer_mm": 4.5, "countersink_mm": 0}, "chamfer's fall: found 2.59"),
        ({"height_mm": 80.0}, "height_mm: found 80, allowed at most 60: 60 turns"),
    ],
)
def test_a_nut_that_cannot_be_is_refused(keys: dict[str, float], line: str) -> None:
    with pytest.raises(ValidationError, match="1 validation error") as caught:
        Nut.model_validate(keys)
    assert line in str(caught.value)

"""Conditions that any press fulfils, for any specimen, in both layouts, by depth or by force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.config.models import Elastomer, Press, Specimen
from twin.mechanics import PressedElastomer, press
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.two_balls import TwoBalls

COARSE = {"solver_pitch_mm": 0.25, "relief_pitch_mm": 0.05}

specimens = st.one_of(
    st.builds(Ball, x_mm=st.floats(-2, 2), diameter_mm=st.floats(4, 10)),
    st.builds(TwoBalls, yaw_deg=st.floats(-180, 180), tilt_deg=st.floats(-4, 4)),
    st.builds(Rod, yaw_deg=st.floats(-180, 180), tilt_deg=st.floats(-2, 2)),
    st.builds(Flat, diameter_mm=st.floats(3, 8), tilt_deg=st.floats(-2, 2)),
    st.builds(Grating, pitch_mm=st.floats(2, 6), groove_mm=st.floats(0.05, 0.4)),
    st.builds(
        lambda x, z: Group(
            parts={"a": Ball(x_mm=-x, diameter_mm=4), "b": Rod(x_mm=x, z_mm=z, length_mm=5)}
        ),
        st.floats(3, 4.5),
        st.floats(-0.3, 0.3),
    ),
)
slabs = st.builds(
    Elastomer,
    thickness_mm=st.floats(1.5, 4),
    length_x_mm=st.just(22.0),
    length_y_mm=st.just(21.0),
    young_modulus_kpa=st.floats(50, 1000),
    poisson_ratio=st.floats(0.3, 0.4999),
    layout=st.sampled_from(["opposite_face", "contact_face"]),
)


def to_depth(depth_mm: float) -> Press:
    return Press.model_validate({"control": "depth", "depth_mm": depth_mm} | COARSE)


def with_force(force_n: float) -> Press:
    return Press.model_validate({"control": "force", "force_n": force_n} | COARSE)


def check(pressed: PressedElastomer, specimen: Specimen, slab: Elastomer) -> None:
    depth = pressed.depth_mm
    height = height_above_lowest(specimen, pressed.x_mm, pressed.y_mm)
    gap = pressed.touched_face_mm - slab.touched_plane_mm + height - depth
    assert pressed.converged
    assert pressed.pressure_kpa.min() >= 0
    assert gap.min() >= -1e-4 * depth
    assert np.abs(gap[pressed.contact]).max() <= 1e-4 * depth
    area = np.diff(pressed.x_mm)[0] * np.diff(pressed.y_mm)[0]
    force_n = pressed.pressure_kpa.sum() * area * 1e-3
    assert pressed.force_n == pytest.approx(force_n, rel=1e-6)
    np.testing.assert_array_equal(pressed.contact, pressed.pressure_kpa > 0)
    assert np.isfinite(pressed.face_z_mm).all()


@settings(max_examples=40)
@given(specimen=specimens, slab=slabs, depth_mm=st.floats(0.2, 1.2))
def test_contact_conditions_hold_for_any_press(
    specimen: Specimen, slab: Elastomer, depth_mm: float
) -> None:
    pressed = press(specimen, slab, to_depth(depth_mm))
    check(pressed, specimen, slab)
    assert pressed.depth_mm == depth_mm


@settings(max_examples=20)
@given(specimen=specimens, slab=slabs, depth_mm=st.floats(0.2, 1.0))
def test_force_control_inverts_depth_control(
    specimen: Specimen, slab: Elastomer, depth_mm: float
) -> None:
    there = press(specimen, slab, to_depth(depth_mm))
    back = press(specimen, slab, with_force(there.force_n))
    check(back, specimen, slab)
    assert back.force_n == pytest.approx(there.force_n, rel=1e-6)
    assert back.depth_mm == pytest.approx(depth_mm, rel=1e-3)
    np.testing.assert_allclose(back.face_z_mm, there.face_z_mm, atol=1e-3 * depth_mm)


@settings(max_examples=10)
@given(specimen=specimens, slab=slabs, depth_mm=st.floats(0.2, 0.9))
def test_deeper_takes_more_force_and_keeps_the_contact(
    specimen: Specimen, slab: Elastomer, depth_mm: float
) -> None:
    shallow, deep = (press(specimen, slab, to_depth(d)) for d in (depth_mm, 1.2 * depth_mm))
    assert deep.force_n > shallow.force_n


@settings(max_examples=8)
@given(cells_x=st.integers(-8, 8), cells_y=st.integers(-8, 8))
def test_a_rigid_shift_of_the_specimen_shifts_the_pad(cells_x: int, cells_y: int) -> None:
    pad = Elastomer(
        thickness_mm=2,
        length_x_mm=24,
        length_y_mm=24,
        young_modulus_kpa=100,
        poisson_ratio=0.49,
        layout="contact_face",
    )
    still = press(Rod(length_mm=4), pad, to_depth(0.4))
    step = float(np.diff(still.x_mm)[0])
    moved = press(Rod(length_mm=4, x_mm=cells_x * step, y_mm=cells_y * step), pad, to_depth(0.4))
    assert moved.x_mm.size == still.x_mm.size
    expected = np.roll(still.pressure_kpa, (cells_y, cells_x), axis=(0, 1))
    np.testing.assert_allclose(moved.pressure_kpa, expected, atol=1e-3 * expected.max())
    assert moved.force_n == pytest.approx(still.force_n, rel=1e-5)


@pytest.mark.parametrize("layout", ["opposite_face", "contact_face"])
@pytest.mark.parametrize(
    "specimen", [Ball(), Rod(), Flat(), Grating(pitch_mm=3)], ids=lambda s: s.kind
)
def test_symmetric_specimens_press_symmetrically(layout: str, specimen: Specimen) -> None:
    slab = Elastomer.model_validate(
        {
            "thickness_mm": 3,
            "length_x_mm": 20,
            "length_y_mm": 20,
            "young_modulus_kpa": 300,
            "poisson_ratio": 0.49,
            "layout": layout,
        }
    )
    pressed = press(specimen, slab, to_depth(0.5))
    for field in (pressed.pressure_kpa, pressed.face_z_mm):
        for mirrored in (field[:, ::-1], field[::-1]):
            np.testing.assert_allclose(field, mirrored, atol=2e-4 * np.abs(field).max())


@settings(max_examples=6)
@given(specimen=specimens, slab=slabs)
def test_the_shape_does_not_depend_on_the_modulus(specimen: Specimen, slab: Elastomer) -> None:
    stiffer = slab.model_copy(update={"young_modulus_kpa": 7 * slab.young_modulus_kpa})
    soft, stiff = (press(specimen, each, to_depth(0.5)) for each in (slab, stiffer))
    np.testing.assert_allclose(stiff.face_z_mm, soft.face_z_mm, atol=1e-9)
    assert stiff.force_n == pytest.approx(7 * soft.force_n, rel=1e-9)

"""A compliant rim: coats of the twin's sheet, compensated and calibrated."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.compensation import (
    KnownTravel,
    SheetLayer,
    SheetOpening,
    calibrate_sheet,
    compensate_sheet,
    parts_of,
)
from reconstruction.errors import FitError
from tests.mechanics.sheets import YOUNG_KPA, build_sheet, pressed
from twin.mechanics import PressedElastomer
from twin.specimens.kinds.ball import Ball

THICKNESS_MM, COMPLIANCE, NOISE_MM = 0.2, 40.0, 5e-4
FRAME_MM = 12.0


@cache
def press(depth_mm: float, air_kpa: float) -> PressedElastomer:
    """Press a ball of 4 mm into a sheet with a compliant rim."""
    sheet = build_sheet(
        thickness_mm=THICKNESS_MM,
        length_x_mm=FRAME_MM,
        length_y_mm=FRAME_MM,
        rim_compliance_mm2_per_n=COMPLIANCE,
    )
    return pressed(Ball(), sheet, depth_mm=depth_mm, back_pressure_kpa=air_kpa, cell_mm=0.15)


def coat(done: PressedElastomer, seed: int) -> tuple[FloatArray, FloatArray]:
    x, y = np.meshgrid(done.face_x_mm, done.face_y_mm)
    noise = np.random.default_rng(seed).normal(scale=NOISE_MM, size=x.shape)
    points = np.stack((x, y, done.face_z_mm + noise), axis=-1).reshape(-1, 3)
    return points, np.full(len(points), NOISE_MM)


def layer(air_kpa: float, **known: float) -> SheetLayer:
    return SheetLayer(
        SheetOpening(FRAME_MM, FRAME_MM),
        THICKNESS_MM,
        YOUNG_KPA,
        back_pressure_kpa=air_kpa,
        **known,
    )


def test_thickness_agrees_with_the_solver() -> None:
    done = press(1.0, 4.0)
    assert done.sheet is not None
    middle = tuple(count // 2 for count in done.face_z_mm.shape)
    true = done.sheet.thickness_mm[middle] / THICKNESS_MM
    known, rigid = (
        compensate_sheet(*coat(done, 1), layer(4.0, rim_compliance_mm2_per_n=compliance))
        for compliance in (COMPLIANCE, 0.0)
    )
    half = known.thinning.shape[0] // 2
    assert known.thinning[half, half] == pytest.approx(true, rel=0.01)
    assert rigid.thinning[half, half] < 0.97 * true
    (ball,) = parts_of(known)
    assert ball.radius_mm == pytest.approx(4.0, abs=3e-3)


def test_uncertainty_of_the_compliance_is_propagated() -> None:
    open_rim = {"rim_compliance_mm2_per_n": 20.0, "sigma_rim_compliance_mm2_per_n": 20.0}
    compensated = compensate_sheet(*coat(press(1.0, 4.0), 1), layer(4.0, **open_rim))
    true = compensate_sheet(
        *coat(press(1.0, 4.0), 1), layer(4.0, rim_compliance_mm2_per_n=COMPLIANCE)
    )
    half = compensated.thinning.shape[0] // 2
    moved = true.thinning[half, half] - compensated.thinning[half, half]
    assert compensated.sigma_thinning[half, half] == pytest.approx(moved, rel=0.1)


@pytest.mark.parametrize("known", ["travel", "modulus"])
def test_a_ball_calibrates_thickness_and_rim(known: str) -> None:
    """Start 10 % too thick and rigid within 40 mm^2/N; then another press to 2 um."""
    travel = KnownTravel(1.0, 1e-3) if known == "travel" else None
    sigma_kpa = 0.03 * YOUNG_KPA if known == "modulus" else 0.0
    prior = replace(
        layer(4.0, sigma_rim_compliance_mm2_per_n=40.0, sigma_young_modulus_kpa=sigma_kpa),
        thickness_mm=1.1 * THICKNESS_MM,
    )
    calibrated = calibrate_sheet(*coat(press(1.0, 4.0), 1), prior, 4.0, travel=travel)
    fitted = calibrated.layer
    assert calibrated.rim_fitted
    assert abs(fitted.thickness_mm - THICKNESS_MM) < 2 * fitted.sigma_thickness_mm < 4e-3
    away = abs(fitted.rim_compliance_mm2_per_n - COMPLIANCE)
    assert away < 2 * fitted.sigma_rim_compliance_mm2_per_n < 40.0
    assert abs(fitted.young_modulus_kpa - YOUNG_KPA) < 2 * fitted.sigma_young_modulus_kpa
    second = compensate_sheet(*coat(press(0.6, 3.0), 2), replace(fitted, back_pressure_kpa=3.0))
    (ball,) = parts_of(second)
    assert ball.radius_mm == pytest.approx(4.0, abs=2e-3)


def test_without_further_data_the_prior_compliance_remains() -> None:
    prior = layer(4.0, sigma_rim_compliance_mm2_per_n=10.0)
    fitted = calibrate_sheet(*coat(press(1.0, 4.0), 1), prior, 4.0).layer
    assert fitted.rim_compliance_mm2_per_n == pytest.approx(0.0, abs=0.1)
    assert fitted.sigma_rim_compliance_mm2_per_n == pytest.approx(10.0, rel=1e-3)


def test_a_rim_without_stiffness_is_rejected() -> None:
    """The free span has half of the stiffness of the stated modulus."""
    known = {"sigma_rim_compliance_mm2_per_n": 200.0, "sigma_young_modulus_kpa": 1.0}
    prior = replace(layer(4.0, **known), young_modulus_kpa=2.0 * YOUNG_KPA)
    with pytest.raises(FitError, match="the rim has a compliance of"):
        calibrate_sheet(*coat(press(1.0, 4.0), 1), prior, 4.0)

"""The object under a thick slab: derivatives of the press, the fit, its uncertainty, its limits."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from reconstruction.errors import FitError, InputError
from tests.compensation.slabs import (
    SPAN_MM,
    WIDE_MM,
    coat_points,
    layer_of,
    pressed,
    slab,
    with_load,
)
from tests.oracles.axisymmetric import Resolution, RoundSlab, press_axisymmetric
from twin.mechanics.slab_tangent import CoatMove, SolvedSlab
from twin.pipeline.slab_model import value_of, with_modulus, with_value
from twin.pipeline.slab_object import calibrate_slab, fit_slab, slab_object
from twin.specimens import shape_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.brick import Brick
from twin.specimens.kinds.two_balls import TwoBalls

SOLIDS = Path(__file__).parents[1] / "mechanics/reference/neo_hookean.json"
BALL = Ball(diameter_mm=8.0, x_mm=0.13, y_mm=-0.07)
AIR_KPA = 10.0
NOISE_MM = 0.003

Pressed = Callable[[float], SolvedSlab]


def differences(press: Pressed, step: float) -> CoatMove:
    """Return central differences of whole presses."""
    low, high = press(-step), press(step)
    coat, force = high.coat_mm - low.coat_mm, high.force_mm2 - low.force_mm2
    return CoatMove(coat / (2 * step), force / (2 * step))


def agrees(move: CoatMove, expected: CoatMove, share: float) -> None:
    scale = float(np.abs(expected.coat_mm).max())
    assert np.abs(move.coat_mm - expected.coat_mm).max() < share * scale


@pytest.mark.parametrize("air_kpa", [0.0, AIR_KPA])
def test_derivatives_are_those_of_whole_presses(air_kpa: float) -> None:
    elastomer, depth = slab(), 0.6
    rest = pressed(BALL, elastomer, depth, air_kpa)

    agrees(
        rest.moved_by_travel(),
        differences(lambda by: pressed(BALL, elastomer, depth + by, air_kpa), 0.01),
        2e-3,
    )
    neighbours = [
        (elastomer.model_copy(update={"thickness_mm": 3.0 + by}), rest.load) for by in (-1e-3, 1e-3)
    ]
    agrees(
        rest.moved_by_layer(neighbours[0], neighbours[1], 1e-3),
        differences(lambda by: pressed(BALL, slab(3.0 + by), depth, air_kpa), 0.02),
        4e-3,
    )
    softer = [(with_modulus(elastomer, 400.0 + by), rest.load) for by in (-0.01, 0.01)]
    by_modulus = rest.moved_by_layer(softer[0], softer[1], 0.01)
    if air_kpa:
        expected = differences(lambda by: pressed(BALL, slab(3.0, 400.0 + by), depth, air_kpa), 4.0)
        agrees(by_modulus, expected, 4e-3)
    else:
        assert np.abs(by_modulus.coat_mm).max() < 1e-12  # the shape does not depend on the modulus


@pytest.mark.parametrize(("path", "share"), [("diameter_mm", 1e-2), ("x_mm", 5e-3)])
def test_the_coat_moves_with_the_ball(path: str, share: float) -> None:
    """Whole presses lose and gain cells at the contact's edge: their differences scatter."""
    elastomer, depth, step = slab(span_mm=WIDE_MM), 0.6, 1e-4
    rest = pressed(BALL, elastomer, depth)
    rows, cols = rest.touched_cells
    behind = [
        shape_of(with_value(BALL, path, value_of(BALL, path) + by)).height_above_lowest(
            rest.layer.x_mm[cols], rest.layer.y_mm[rows]
        )
        for by in (-step, step)
    ]
    move = rest.moved_by((behind[0] - behind[1]) / (2 * step))
    by_pressing = differences(
        lambda by: pressed(with_value(BALL, path, value_of(BALL, path) + by), elastomer, depth), 0.1
    )
    agrees(move, by_pressing, share)


@pytest.mark.parametrize(
    ("true", "begun", "path", "within_mm"),
    [
        (BALL, Ball(diameter_mm=7.0), "diameter_mm", 0.008),
        (TwoBalls(diameter_mm=6.0, separation_mm=6.0, yaw_deg=8.0),
         TwoBalls(diameter_mm=5.5, separation_mm=6.3), "diameter_mm", 0.006),
        (Bar(width_mm=4.0, length_mm=9.0, yaw_deg=4.0, x_mm=0.1),
         Bar(width_mm=4.4, length_mm=9.0), "width_mm", 0.006),
    ],
)  # fmt: skip
def test_numbers_converge_from_a_poor_start(true, begun, path: str, within_mm: float) -> None:
    """With air, a coat from another grid; the travel is unknown."""
    span_mm = WIDE_MM if true.kind == "two_balls" else SPAN_MM
    elastomer = slab(span_mm=span_mm)
    coat = pressed(true, elastomer, 0.7, AIR_KPA).coat_mm
    request = replace(slab_object(layer_of(elastomer, AIR_KPA), begun), theory=False)
    fitted = fit_slab(*coat_points(coat, NOISE_MM, span_mm=span_mm), request).fitted
    assert fitted.value(f"specimen.{path}") == pytest.approx(value_of(true, path), abs=within_mm)
    assert fitted.value("press.depth_mm") == pytest.approx(0.7, abs=1e-3)
    assert fitted.chi_square == pytest.approx(1.0, abs=0.05)
    error = fitted.value(f"specimen.{path}") - value_of(true, path)
    assert abs(error) < 3.5 * fitted.sigma(f"specimen.{path}")


def test_travel_and_force_are_data() -> None:
    """Without air the coat hardly separates a ball's diameter from its travel."""
    rest = pressed(BALL, slab(), 0.7)
    points, bare = coat_points(rest.coat_mm, NOISE_MM), layer_of(slab())

    def sigma(layer, **known) -> float:
        request = replace(slab_object(layer, Ball(diameter_mm=7.9)), theory=False)
        fitted = fit_slab(*points, request).fitted
        diameter_mm = fitted.value("specimen.diameter_mm")
        u = fitted.sigma("specimen.diameter_mm")
        assert diameter_mm == pytest.approx(8.0, abs=3.5 * u)
        return u

    free = sigma(bare)
    with_travel = sigma(with_load(bare, {"depth_mm": 0.002}, depth_mm=0.7))
    exact = sigma(with_load(bare, {"depth_mm": 0.0}, depth_mm=0.7))
    force = 1e-3 * 400.0 * rest.force_mm2
    weighed = sigma(with_load(bare, {"force_n": 0.0}, force_n=force))
    assert exact < 0.3 * with_travel < 0.3 * free
    assert weighed < free


def test_uncertainty_covers_large_strain() -> None:
    """A linear slab against neo-Hookean solids, which are 2 % lower in the middle.

    The solids' round rim differs from ours: the change by large strain is added to our coat.
    """
    case = json.loads(SOLIDS.read_text(encoding="utf-8"))["free_r4_h4_d1"]
    span = 2 * case["slab"]["outer_radius_mm"]
    linear = press_axisymmetric(
        RoundSlab(**case["slab"]), 4.0, 1.0, linear=True, resolution=Resolution(36, 12)
    )
    radii = np.array(case["r_mm"])
    changed = np.array(case["far_face_mm"]) - linear.far_face_mm(radii)
    assert changed.min() == pytest.approx(-0.0162, abs=1e-3)
    elastomer = slab(4.0).model_copy(update={"length_x_mm": span, "length_y_mm": span})
    coat = pressed(Ball(diameter_mm=8.0), elastomer, 1.0).coat_mm
    places = (np.arange(len(coat)) + 0.5) * span / len(coat) - span / 2
    x, y = np.meshgrid(places, places)
    z = coat + np.interp(np.hypot(x, y), radii, changed, right=0.0)
    z += np.random.default_rng(3).normal(scale=5e-4, size=z.shape)
    points = np.stack((x, y, z), axis=-1).reshape(-1, 3), np.full(z.size, 5e-4)
    bare = layer_of(elastomer)
    exact = with_load(bare, {"depth_mm": 0.0}, depth_mm=1.0)
    fitted = fit_slab(*points, slab_object(exact, Ball(diameter_mm=8.0))).fitted
    error, u = fitted.value("specimen.diameter_mm") - 8.0, fitted.sigma("specimen.diameter_mm")
    assert abs(error) < 2 * u < 0.08 * 8.0
    assert -2.0 < fitted.value("theory.large_strain") < -0.5
    linear_only = replace(slab_object(exact, Ball(diameter_mm=8.0)), theory=False)
    without = fit_slab(*points, linear_only).fitted
    assert without.value("specimen.diameter_mm") - 8.0 < -3 * without.sigma("specimen.diameter_mm")
    assert fitted.misfit_mm > 3 * 5e-4  # the coat itself shows the model's error


def test_thickness_is_calibrated_on_a_known_ball() -> None:
    """1 % of thickness: another ball has an error before the calibration, and none after it."""
    true, nominal = slab(3.03), slab(3.0)
    layer = with_load(layer_of(nominal), {"depth_mm": 0.0}, depth_mm=0.7)
    known, second_ball = Ball(diameter_mm=8.0), Ball(diameter_mm=6.0)
    first, second = (
        coat_points(pressed(ball, true, 0.7).coat_mm, NOISE_MM, seed)
        for seed, ball in enumerate((known, second_ball))
    )

    def error_mm(layer) -> float:
        request = replace(slab_object(layer, Ball(diameter_mm=6.1)), theory=False)
        return fit_slab(*second, request).fitted.value("specimen.diameter_mm") - 6.0

    before = error_mm(layer)
    calibrated, figures = calibrate_slab(*first, slab_object(layer, Ball(diameter_mm=7.0)), 8.0)
    after = error_mm(calibrated)
    assert abs(before) > 0.03
    assert abs(after) < 0.1 * abs(before)
    u = figures["calibrated_thickness_sigma_um"]
    assert figures["calibrated_thickness_mm"] == pytest.approx(3.03, abs=3.5e-3 * u)
    assert calibrated.sigma.thickness_mm == pytest.approx(1e-3 * u)
    assert abs(figures["radius_before_calibration_mm"] - 4.0) > 0.02
    assert figures["calibrated_modulus_kpa"] is None  # no load determines it


def test_air_determines_the_modulus_too() -> None:
    true = slab(3.0, 440.0)
    coat = pressed(Ball(diameter_mm=8.0), true, 0.7, AIR_KPA).coat_mm
    layer = layer_of(slab(3.0, 400.0), AIR_KPA)
    calibrated, figures = calibrate_slab(
        *coat_points(coat, NOISE_MM), slab_object(layer, Ball(diameter_mm=7.0)), 8.0
    )
    u = figures["calibrated_modulus_sigma_kpa"]
    assert figures["calibrated_modulus_kpa"] == pytest.approx(440.0, abs=max(3.5 * u, 0.5))
    assert calibrated.elastomer.young_modulus_kpa == figures["calibrated_modulus_kpa"]


def test_the_plane_of_the_points_may_be_off() -> None:
    """A frame 5 um off and tilted: wrong if it is taken as exact, right if uncertain."""
    coat = pressed(BALL, slab(), 0.7, AIR_KPA).coat_mm
    points, sigma = coat_points(coat, NOISE_MM)
    points[:, 2] += 0.005 + 0.008 * points[:, 0] / (SPAN_MM / 2)
    fits = []
    for plane_mm in (0.0, 0.01):
        layer = layer_of(slab(), AIR_KPA, plane_mm=plane_mm)
        request = replace(slab_object(layer, BALL), theory=False)
        fits.append(fit_slab(points, sigma, request).fitted)
    errors = [abs(ball.value("specimen.diameter_mm") - 8.0) for ball in fits]
    assert errors[1] < 3.5 * fits[1].sigma("specimen.diameter_mm")
    assert errors[1] < 0.3 * errors[0]
    assert fits[1].value("plane.lift_x_mm") == pytest.approx(0.008, abs=5e-4)


def test_contact_and_force_are_those_of_the_press() -> None:
    rest = pressed(BALL, slab(), 0.7, AIR_KPA)
    request = replace(slab_object(layer_of(slab(), AIR_KPA), BALL), theory=False)
    result = fit_slab(*coat_points(rest.coat_mm, NOISE_MM), request)
    assert result.force_n == pytest.approx(0.4 * rest.force_mm2, rel=2e-3)
    area = float(rest.touching.sum()) * rest.layer.cell_area_mm2
    assert result.area_mm2 == pytest.approx(area, rel=0.03)
    touched = result.object_mm[result.contact]
    away = np.linalg.norm(touched - [0.13, -0.07, 0.7 - 3.0 - 4.0], axis=-1)
    assert away == pytest.approx(4.0, abs=2e-3)  # on the ball
    edge = ndimage.binary_dilation(result.contact) & ~result.contact
    behind = np.linalg.norm(result.object_mm[edge] - [0.13, -0.07, 0.7 - 3.0 - 4.0], axis=-1) - 4.0
    assert np.abs(behind).max() < 0.04  # and close to it near the edge, to half a cell


@pytest.mark.parametrize(
    ("specimen", "fitted", "message"),
    [
        (None, (), "add [specimen] to the layer file"),
        (Brick(), (), "not known which of its numbers"),
        (BALL, ("radius_mm",), "found 'radius_mm', allowed numbers"),
        (BALL, ("kind",), "found 'kind', allowed numbers"),
    ],
)
def test_bad_input_gives_a_single_clear_line(
    specimen, fitted: tuple[str, ...], message: str
) -> None:
    layer = layer_of(slab()).model_copy(update={"fitted": fitted})
    with pytest.raises(InputError, match=message.replace("[", r"\[")):
        slab_object(layer, specimen)


def test_only_a_ball_calibrates() -> None:
    request = slab_object(layer_of(slab()), Bar())
    with pytest.raises(InputError, match="kind = 'bar', allowed a ball"):
        calibrate_slab(*coat_points(np.zeros((160, 160)), NOISE_MM), request, 8.0)


def test_a_number_that_runs_to_its_end_is_no_result() -> None:
    """Started at 1.9 mm, a diameter may reach 7.6 mm; the ball has 8 mm."""
    coat = pressed(BALL, slab(), 0.7, AIR_KPA).coat_mm
    request = replace(slab_object(layer_of(slab(), AIR_KPA), Ball(diameter_mm=1.9)), theory=False)
    with pytest.raises(FitError, match=r"specimen\.diameter_mm ran to 7\.6"):
        fit_slab(*coat_points(coat, NOISE_MM), request)


def test_inseparable_numbers_are_named() -> None:
    """A ball's height in a group has no effect: the travel counts from first contact."""
    coat = pressed(BALL, slab(), 0.7).coat_mm
    layer = layer_of(slab()).model_copy(update={"fitted": ("diameter_mm", "yaw_deg")})
    with pytest.raises(FitError, match=r"does not depend on specimen\.yaw_deg"):
        fit_slab(*coat_points(coat, NOISE_MM), slab_object(layer, BALL))

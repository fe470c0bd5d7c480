"""Predictions from the trace, against the spread of many measurements."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.pipeline.conftest import CENTRE
from twin.config import load_experiment, vary
from twin.config.sensor_layer import sensor_layer_of
from twin.config.sigma import LayerSigma
from twin.mechanics import face_mesh
from twin.optics.session import activate
from twin.pipeline import Memory, measure
from twin.pipeline.bound import bounds_alone, object_bounds, predicted
from twin.pipeline.gradients import bound_gradient, value_at
from twin.pipeline.press import press
from twin.results.bound import bound_names, information_shares, is_bound_name
from twin.results.names import figure_names

SMALL = CENTRE | {"camera.binning": 4, "press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.16}
TRIALS = 40


@pytest.fixture(scope="module")
def balls():
    return load_experiment("examples/slab_balls", SMALL)


def heights_and_radii(experiment, trials):
    memory, heights, figures = Memory(), [], []
    for trial in range(trials):
        done = measure(experiment, memory=memory, trial=trial)
        heights.append(done.fringes.reconstruction.point_map.points_world_mm[..., 2])
        figures.append(done.metrics)
    return np.array(heights, np.float64), figures


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"patterns.steps": 5, "patterns.period_px": 12.0, "decode.use": "both"},
    ],
    ids=["default", "five steps, both axes"],
)
def test_predicted_sigma_is_the_spread_of_measurements(balls, changes):
    """40 measurements with noise of its own each, pixel by pixel and for the fitted radii.

    Expected: spread over prediction is 1, per pixel 11 % by the number of trials, 3 % in the mean;
    where the filter gives relief back in part it fluctuates with the noise and spreads a little
    more. Radii: 11 % each, 8 % in the mean of two; `./run bench bound` takes many more.
    """
    experiment = vary(balls, changes)
    heights, figures = heights_and_radii(experiment, TRIALS)
    memory = Memory()
    prediction, _ = predicted(experiment, press(experiment, memory), memory)
    both = prediction.valid & np.all(heights != 0.0, axis=0)
    assert both.mean() > 0.98 * prediction.valid.mean()
    ratio = heights.std(axis=0, ddof=1)[both] / prediction.filtered_mm[both]
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert ratio.std() < 0.18
    bounds, over, under = bounds_alone(experiment, memory)[1], [], []
    assert figures[0]["object_radius_1_mm"] is None  # a thick slab's coat is not the ball
    for name in ("sphere_1_radius", "sphere_2_radius"):
        spread_um = 1e3 * np.std([row[f"{name}_mm"] for row in figures], ddof=1)
        over.append(np.log(bounds[f"{name}_spread_um"] / spread_um))
        under.append(np.log(bounds[f"{name}_crb_um"] / spread_um))
    assert np.mean(over) == pytest.approx(0.0, abs=0.18)
    assert np.mean(under) == pytest.approx(0.0, abs=0.21)


def test_bounds_beside_and_alone_are_the_same(balls):
    """The figures do not depend on whether anything was measured; all are named beforehand."""
    measured = measure(balls, bound=True).metrics
    alone = bounds_alone(balls, Memory())[1]
    bounds = {name: value for name, value in measured.items() if is_bound_name(name)}
    assert bounds == {name: value for name, value in alone.items() if is_bound_name(name)}
    # Why a bound is absent is a figure where one is absent only.
    reasons = {name for name in bound_names(balls) if name.endswith("_bound_why")}
    assert set(bounds) | reasons == bound_names(balls)
    assert measured["exposure_ms"] == pytest.approx(alone["exposure_ms"], rel=1e-3)
    assert not any(is_bound_name(name) for name in measure(balls).metrics)


def test_more_light_and_shorter_fringes_bound_lower(balls):
    """In shot noise the bound is proportional to the period and to 1 / sqrt(light)."""

    def bound(**changes):
        changed = {name.replace("__", "."): value for name, value in changes.items()}
        return bounds_alone(vary(balls, changed), Memory())[1]["crb_radius_um"]

    dim = bound(camera__exposure_ms=40.0)
    assert dim / bound(camera__exposure_ms=80.0) == pytest.approx(np.sqrt(2.0), rel=0.03)
    assert bound(camera__exposure_ms=40.0, patterns__period_px=9.0) < 0.6 * dim


def test_what_a_slab_shows_of_its_object_is_bounded():
    """Through optics and mechanics: by twice the light, and by the uncertainty of the travel.

    The whole fit is held against this bound in `./run bench compensation`.
    """
    balls = load_experiment("examples/slab_balls", {"camera.binning": 4})
    layer = sensor_layer_of(balls)
    unknown = layer.model_copy(update={"sigma": LayerSigma(young_modulus_kpa=0.0)})
    exact = layer.model_copy(update={"sigma": LayerSigma(young_modulus_kpa=0.0, depth_mm=0.0)})

    def bound(exposure_ms, layer):
        lit = vary(balls, {"camera.exposure_ms": exposure_ms})
        return object_bounds(lit, layer, Memory())

    dim, bright, known = bound(40.0, unknown), bound(80.0, unknown), bound(80.0, exact)
    name = "compensated_diameter_crb_um"
    assert {key for key in figure_names(balls) if key.endswith(("_crb_um", "_crb_deg"))} >= set(dim)
    assert dim[name] / bright[name] == pytest.approx(np.sqrt(2.0), rel=0.05)
    assert known[name] < 0.9 * bright[name]
    assert bright["compensated_x_crb_um"] < bright[name]
    sheet = load_experiment("examples/wrapped_balls", {"camera.binning": 4})
    assert object_bounds(sheet, layer, Memory()) == {}  # its object has a free form


FIELDS = {
    "coating.base_albedo": 0.001,
    "coating.flake_fraction": 0.001,
    "coating.flake_roughness": 0.001,
    "projector.pose.polar_deg": 0.05,
    "projector.pose.standoff_mm": 0.2,
    "projector.focus_mm": 0.5,
    "camera.auto_level": 0.002,
    "patterns.period_px": 0.05,
}


def test_derivatives_of_a_bound_are_central_differences(balls):
    """Eight fields, through trace, exposure, blur, noise, triangulation; the same pixels: 1e-3."""
    experiment = vary(balls, {"projector.aperture_mm": 10.0, "projector.focus_mm": 205.0})
    memory = Memory()
    figures, slopes = bound_gradient(experiment, list(FIELDS), memory)
    pressed = press(experiment, memory)
    prediction, truth = predicted(experiment, pressed, memory)
    shares = information_shares(experiment, prediction, truth, pressed.pressed)["crb_radius_um"]
    assert shares.sum() == pytest.approx(1.0)
    assert shares.min() >= 0.0

    def log_bound(path, value):
        varied = vary(experiment, {path: value})
        sigma = predicted(varied, press(varied, memory), memory)[0].single_mm
        return np.sum(shares * np.log(np.where(shares > 0.0, sigma, 1.0)))

    for number, (path, step) in enumerate(FIELDS.items()):
        value = value_at(experiment, path)
        change = (log_bound(path, value + step) - log_bound(path, value - step)) / (2.0 * step)
        slope = slopes["crb_radius_um"][number] / figures["crb_radius_um"]
        assert slope == pytest.approx(change, rel=1e-3), path


def test_derivatives_of_frames_are_central_differences(balls):
    """Sum and sum of squares over a phase frame and the white one, by coat, angle and camera."""
    experiment = vary(balls, {"camera.width_px": 256, "camera.height_px": 192})
    activate()
    from twin.optics.gradients import trace_tangent
    from twin.pipeline import trace

    face = press(experiment, Memory())
    geometry = trace.load_face(experiment, face_mesh(face.pressed))

    def rendered(varied):
        view = trace.view_of(varied, geometry)
        tables, rays = trace.tables_of(varied, view), trace.patches_of(varied, geometry, view)
        lit = trace.light(varied, geometry, view, trace.Traced(rays, None, tables), lambda _: None)
        return [lit.frames[n].astype(np.float64) for n in (2, -2)], view, tables

    still, view, tables = rendered(experiment)
    for path, step in (
        ("coating.flake_fraction", 0.002),
        ("projector.pose.polar_deg", 0.2),
        ("camera.pose.standoff_mm", 0.1),
    ):
        value = value_at(experiment, path)

        def moved(by, path=path, value=value):
            return vary(experiment, {path: value + by})

        trace.dress(experiment, geometry)
        scene = geometry.scene
        tangents = trace_tangent(
            scene, view.rig, experiment, moved, step=step, tables=tables
        ).frames
        high, low = rendered(moved(step))[0], rendered(moved(-step))[0]
        for n, (up, down, here) in enumerate(zip(high, low, still, strict=True)):
            tangent = tangents[(2, -2)[n]]
            of_sum, of_square = np.sum(up - down) / (2 * step), np.sum(up**2 - down**2) / (2 * step)
            # Rounding of single-precision frames: 1.0e-3 on one maker's processor.
            assert np.sum(tangent) == pytest.approx(of_sum, rel=2e-3), path
            assert np.sum(2 * here * tangent) == pytest.approx(of_square, rel=2e-3), path


def test_what_moves_press_or_camera_has_no_derivative(balls):
    for path in ("press.depth_mm", "camera.pose.standoff_mm", "elastomer.thickness_mm"):
        with pytest.raises(InputError, match="found no derivative by it"):
            bound_gradient(balls, [path], Memory())


def test_single_images_have_no_bound_and_are_measured_without_one(balls):
    """The information of such an image depends on the place: no figure is returned."""
    periods = [15.5, 15.76, 16.45, 20.4, 20.72]
    further = {"patterns.period_px": 18.0, "patterns.further_periods_px": periods}
    experiment = vary(balls, {"patterns.code": "micro", "patterns.steps": 3} | further)
    with pytest.raises(InputError, match="micro"):
        bounds_alone(experiment, Memory())
    assert not set(measure(experiment, bound=True).metrics) & bound_names(balls)

"""A measurement without one valid point: absent figures, and a dash with the reason in reports."""

import json
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.capture.folder import Capture
from reconstruction.pipeline import Reconstruction, reconstruct
from reconstruction.triangulation import PointMap
from tests.report.conftest import record_analytically
from twin.config import vary
from twin.pipeline.captures import options_of
from twin.pipeline.fringes import evaluate
from twin.report.contact import discussion, verdicts
from twin.report.measurement import summary_table, write_report
from twin.results.balls import region_of
from twin.results.figures import why_absent
from twin.results.folder import read_measurement, write_measurement
from twin.results.record import Fringes, Recording
from twin.results.score import metrics, score
from twin.specimens import shape_of

ERRORS = ("z_rmse_um", "z_bias_um", "z_p95_um", "sigma_z_median_um", "error_over_sigma")


@pytest.fixture(scope="module")
def recording(experiment, pressed):
    return record_analytically(experiment, pressed)


@pytest.fixture(scope="module")
def blind(experiment, pressed, recording, tmp_path_factory):
    """Folder of a measurement with all pixels at the camera's black level."""
    recorded = recording.capture
    dark = np.full_like(recorded.stack, recorded.sensor.black_level_dn)
    capture = Capture(
        dark, recorded.patterns, recorded.sensor, recorded.calibration, recorded.bit_depth
    )
    reconstruction = reconstruct(capture, options_of(experiment.decode))
    folder = tmp_path_factory.mktemp("blind") / "result"
    folder.mkdir()
    exposed = Recording(recording.radiance, capture, recording.exposure_ms)
    write_measurement(folder, "measure", evaluate(experiment, pressed, exposed, reconstruction))
    return folder


def with_points(reconstruction, visible):
    """The same reconstruction with only these pixels (row, col)."""
    points = reconstruction.point_map
    reason = np.where(visible, points.mask_reason, 8).astype(points.mask_reason.dtype)
    sparse = PointMap(points.points_world_mm, points.sigma_xyz_mm, reason, points.T_world_from_cam)
    return Reconstruction(reconstruction.decoded, sparse)


def test_figures_of_nothing_are_null(blind):
    figures = json.loads((blind / "result.json").read_text())["metrics"]
    assert figures["points"] == 0
    assert figures["completeness"] == figures["good_share"] == 0.0
    assert [figures[name] for name in (*ERRORS, "wrong_order_pixels")] == [None] * 6
    assert figures["sphere_1_rmse_mm"] is figures["sphere_2_radius_mm"] is None
    assert len(figures["unfitted_balls"]) == 2
    assert why_absent(figures) == "no valid point"


def test_report_and_table_say_why(blind):
    table = summary_table(read_measurement(blind))
    assert "z error against the true coat: none, no valid point" in table
    assert "points on 0.0% of the lit pixels, - wrong fringe orders" in table
    assert verdicts(read_measurement(blind))[0].headline == "no valid point"
    page = write_report(blind).read_text()
    assert "no valid point" in page
    assert "None" not in page


def test_figures_that_take_more_points_than_there_are(experiment, recording):
    """One point has an error but no spread; four fix a sphere exactly, five leave a residual."""
    whole = reconstruct(recording.capture, options_of(experiment.decode))
    ball = shape_of(experiment.specimen).spheres()[0]
    points = whole.point_map
    usable = points.valid & recording.truth.lit
    near = region_of(ball, points.points_world_mm, usable, experiment.score.roi_radius_mm)
    spread_out = np.flatnonzero(near)[:: near.sum() // 5]

    def figures(count):
        visible = np.zeros(near.shape, bool)
        visible.ravel()[spread_out[:count]] = True
        return metrics(score(experiment, with_points(whole, visible), recording.truth))

    single = figures(1)
    assert single["z_rmse_um"] > 0.0
    assert single["error_over_sigma"] is None
    assert figures(4)["sphere_1_rmse_mm"] is None
    assert figures(5)["sphere_1_rmse_mm"] > 0.0


def test_a_single_point_has_a_report_without_a_spread(experiment, blind, recording):
    whole = reconstruct(recording.capture, options_of(experiment.decode))
    visible = np.zeros(whole.point_map.valid.shape, bool)
    visible.ravel()[np.flatnonzero(whole.point_map.valid & recording.truth.lit)[0]] = True
    single = with_points(whole, visible)
    scored = read_measurement(blind)
    rated = score(experiment, single, recording.truth)
    measured = replace(
        scored,
        metrics={**scored.metrics, **metrics(rated)},
        images=Fringes(recording.capture, single),
        truth=recording.truth,
        score=rated,
    )
    assert "normalised error (error / predicted sigma) – " in " ".join(
        verdicts(measured)[0].reasons
    )
    assert "a single point has no spread" in discussion(measured)[0]


def test_shares_of_no_pixel_are_absent(experiment, recording):
    whole = reconstruct(recording.capture, options_of(experiment.decode))
    direct = vary(experiment, {"modality": "direct_fpp"})
    truth = recording.truth
    unseen = type(truth)(
        **{name: getattr(truth, name) for name in truth.__annotations__ if name != "measured"},
        measured=np.zeros_like(truth.measured),
    )
    figures = metrics(score(direct, whole, unseen))
    assert figures["completeness"] is figures["good_share"] is figures["z_rmse_um"] is None
    assert why_absent(figures) == "no pixel that ought to give a point"

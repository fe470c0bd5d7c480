"""A rough coat through camera and decoder: residuals of a sphere fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from reconstruction.evaluate.fit import fit_sphere
from reconstruction.pipeline import reconstruct
from twin.config import load_experiment
from twin.config.models import Texture
from twin.mechanics import textured
from twin.pipeline import record
from twin.pipeline.captures import options_of

COARSE = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480}
TEXTURE = Texture(rms_um=12, correlation_mm=0.3)


def rmse_um(points_mm, region):
    return 1e3 * fit_sphere(points_mm[region].astype(np.float64)).stats.rmse_mm


@pytest.fixture(scope="module")
def recorded(mi, ball_cap):
    """Recordings of an ideal cap, smooth and rough."""
    experiment = load_experiment("examples/slab_balls", COARSE)
    # Not the press that the cap replaces: its material does not move.
    cap = replace(ball_cap, model="fem")
    rough = textured(cap, experiment.elastomer, experiment.press, TEXTURE, seed=1)
    return record(experiment, cap), record(experiment, rough)


@pytest.fixture(params=[0, 8])
def residuals(request, recorded):
    """Residuals of sphere fits: measured and true of both caps, and true under the filter, um."""
    decode = load_experiment("examples/slab_balls", {"decode.filter_taps": request.param}).decode
    true = [recording.truth.points_world_mm.astype(np.float64) for recording in recorded]
    maps = [reconstruct(each.capture, options_of(decode)).point_map for each in recorded]
    region = np.hypot(true[0][..., 0], true[0][..., 1]) < 2.0
    for points, recording in zip(maps, recorded, strict=True):
        region &= points.valid & recording.truth.lit
    blurred = true[0].copy()
    sigma_px = decode.filter_sigma_px if decode.filter_taps else 0.0
    blurred[..., 2] += ndimage.gaussian_filter((true[1] - true[0])[..., 2], sigma_px, radius=4)
    return {
        "taps": request.param,
        "measured": [rmse_um(points.points_world_mm, region) for points in maps],
        "true": [rmse_um(points, region) for points in true],
        "blurred": rmse_um(blurred, region),
    }


def test_the_true_face_is_the_textured_one(residuals):
    """Expected: 6 nm on the smooth cap, by its facets; the texture's RMS on the rough one.

    Of 12 um to 10 %, since the cap holds some 45 areas of correlation; of this seed 12.36 um.
    """
    assert residuals["true"][0] < 0.02
    assert residuals["true"][1] == pytest.approx(TEXTURE.rms_um, rel=0.1)
    assert residuals["true"][1] == pytest.approx(12.36, rel=0.01)


def test_residuals_add_in_quadrature(residuals):
    """Expected: the residual of the smooth cap, and the texture, whole or as the decoder shows it.

    Unfiltered to 3 %, of which a pixel's own box is 1 %. The filter restores the relief that its
    Gaussian removes, as far as it exceeds the noise: the residual is between that under the
    plain Gaussian, to 15 %, and the true one.
    """
    if residuals["taps"]:
        least = np.hypot(residuals["measured"][0], residuals["blurred"])
        assert 0.85 * least < residuals["measured"][1] < 1.03 * residuals["true"][1]
        return
    expected = np.hypot(residuals["measured"][0], residuals["blurred"])
    assert residuals["measured"][1] == pytest.approx(expected, rel=0.03)

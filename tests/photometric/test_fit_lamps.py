"""Fitted lamps on held-out data: other presses, and another unit."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import fit_lamps
from benchmarks.fit_lamps import CHANNELS, UNITS, fit, shading_of
from benchmarks.real_presses import RealPresses, circle_of, read_presses, spots_of
from twin.config import load_experiment

# Ten times less: three times the steps, misfits smaller by 2 % (9 % without transmission).
TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/gelsight_ball", {"modality": "contact_fpp"})


@pytest.fixture(scope="module")
def presses():
    return read_presses()


def rms(levels):
    return float(np.sqrt(np.mean(np.square(levels))))


def part(presses: RealPresses, chosen) -> RealPresses:
    """Return the spots of some presses."""
    is_chosen = np.isin(presses.of_press, chosen)
    spots = {key: getattr(presses, key)[is_chosen] for key in ("across", "before", "during")}
    return replace(presses, of_press=presses.of_press[is_chosen], **spots)


def test_held_out_presses_are_predicted(presses):
    """Setup: every third press fits the blue lamp, the next ones are held out.

    Expected: the misfit of held-out presses is nearly that of the fitted ones; a coat without
    transmission increases it by 20 %.
    """
    others = part(presses, range(1, len(presses.presses), 3))

    def misfit(settings):
        plain = {"modality": "contact_fpp"}
        case = load_experiment("examples/gelsight_ball", plain | settings)
        fitted = shading_of(case, part(presses, range(0, len(presses.presses), 3)))
        lamps = fit(fitted, "blue", TOLERANCE)
        image = shading_of(case, others).image(lamps)
        return rms(image.during - image.before - others.change[:, CHANNELS.index("blue")])

    residual = misfit({})
    assert residual < 6.2 < 0.3 * rms(others.change[:, CHANNELS.index("blue")])
    assert misfit({"coating.transmittance": 0.0}) > 1.1 * residual


def test_lamps_of_a_unit_fit_a_second_unit(experiment, presses, monkeypatch):
    """Fitted to one unit and half of the presses, to 1.7 levels; on the other 4.2 of some 95.

    The units differ by 5.4 levels.
    """
    shading = shading_of(experiment, part(presses, range(0, len(presses.presses), 2)))
    monkeypatch.setattr(fit_lamps, "UNITS", UNITS[:1])
    backgrounds = np.stack(
        [shading.background(fit(shading, channel, TOLERANCE)) for channel in CHANNELS]
    )
    assert rms(backgrounds - UNITS[0]) < 2.4
    assert rms(backgrounds - UNITS[1]) < 4.6
    assert rms(UNITS[0] - UNITS[1]) == pytest.approx(5.4, abs=0.05)


def test_spots_are_at_the_places_of_the_file(presses):
    """Setup: an image with its columns and rows as levels.

    Expected: the spots' mean levels are their own places, to 0.33 px; 17 spots of a press inside
    the image.
    """
    whole = next(press for press in presses.presses if abs(press.x_mm) < 4 and abs(press.y_mm) < 3)
    row, col = np.indices((240, 320))
    circle = circle_of(whole)
    across, levels = spots_of(np.stack([col, row, row], axis=-1), circle)
    assert len(across) == 17
    np.testing.assert_allclose(
        levels[:, 0], circle.col_px + circle.radius_px * across[:, 0], atol=0.33
    )
    np.testing.assert_allclose(
        levels[:, 1], circle.row_px - circle.radius_px * across[:, 1], atol=0.33
    )

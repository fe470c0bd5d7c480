"""Projector pixels that are not square: light of diamond pixels, and the key in files."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.capture.description import read_manifest, write_manifest
from reconstruction.capture.frame_arrangement import ProjectorSize
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.pixel_shape import smear_px, width_over_height
from reconstruction.rig.projected_light import blurred

SHOWN = PatternSet(912, 1140, steps=4, pixel_ratio="diamond")


def mirrors(levels, u_px, v_px):
    """Return the light at points (u, v) of an array of diamonds, summed mirror by mirror.

    Parameters
    ----------
    levels : function of column and row of a mirror
    """
    light = np.zeros(np.broadcast(u_px, v_px).shape)
    for row in range(4, 9):
        displaced = -0.25 if row % 2 == 0 else 0.25
        for column in range(4, 15):
            inside = np.abs(u_px - column - displaced) / 0.5 + np.abs(v_px - row) < 1.0
            light += inside * levels(column, row)
    return light


def test_light_along_columns_is_the_mean_of_two_rows():
    light = np.random.default_rng(0).random((20, 1))
    u_px, v_px = np.arange(6.0, 12.0, 1 / 16), 5.0 + (np.arange(4000) + 0.5) / 2000
    wanted = mirrors(lambda c, r: light[c, 0], u_px[:, None], v_px).mean(axis=1)
    profile = blurred(light, u_px, 0.0, smear_px("diamond", "column"))[:, 0]
    np.testing.assert_allclose(profile, wanted, atol=1e-3)


def test_light_along_rows_is_the_mean_of_a_column():
    light = np.random.default_rng(0).random((20, 1))
    v_px, u_px = np.arange(5.0, 7.0, 1 / 16), 8.0 + (np.arange(4000) + 0.5) / 4000
    wanted = mirrors(lambda c, r: light[r, 0], u_px, v_px[:, None]).mean(axis=1)
    profile = blurred(light, v_px, 0.0, smear_px("diamond", "row"))[:, 0]
    np.testing.assert_allclose(profile, wanted, atol=1e-3)


def test_blur_of_diamonds_is_the_mean_of_blurred_boxes():
    light, at_px = np.random.default_rng(1).random((20, 1)), np.arange(4.0, 15.0, 1 / 16)
    offsets = (np.arange(400) + 0.5) / 400 - 0.5
    wanted = np.mean([blurred(light, at_px + offset, 0.6) for offset in offsets], axis=0)
    np.testing.assert_allclose(blurred(light, at_px, 0.6, 1.0), wanted, atol=1e-5)


def test_manifest_keeps_the_ratio_and_square_ones_do_not_name_it(tmp_path):
    for shown in (SHOWN, replace(SHOWN, pixel_ratio=0.5), replace(SHOWN, pixel_ratio=1.0)):
        write_manifest(tmp_path / "patterns.toml", shown)
        assert read_manifest(tmp_path / "patterns.toml") == shown
    assert "pixel_ratio" not in (tmp_path / "patterns.toml").read_text()


def test_ratios():
    assert [width_over_height(ratio) for ratio in ("diamond", 1.0, 0.5)] == [2.0, 1.0, 0.5]
    assert smear_px(2.0, "row") == 0.0


@pytest.mark.parametrize(("ratio", "message"), [("square", '"diamond"'), (0.0, "0.1"), (99, "10")])
def test_impossible_ratios_are_named(ratio, message):
    with pytest.raises(InputError, match=message):
        ProjectorSize(912, 1140, ratio)
    with pytest.raises(InputError, match=message):
        PatternSet(912, 1140, pixel_ratio=ratio)

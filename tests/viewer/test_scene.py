"""Content of the live view's scene, without a browser: surfaces, section, devices, viewpoints."""

import re
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.colouring import Deviation
from twin.config import load_experiment
from twin.mechanics import press
from twin.viewer.drawing import section_drawing
from twin.viewer.preview import thinned
from twin.viewer.scene import (
    behind,
    coat_surface,
    devices,
    front_mm,
    heights_mm,
    near_mm,
    section_of,
    specimen_surface,
    viewpoints,
)
from twin.viewer.texts import command_line, deviation_scale, height_scale


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/slab_balls")


@pytest.fixture(scope="module")
def pressed(experiment):
    return thinned(press(experiment.specimen, experiment.elastomer, experiment.press))


@pytest.fixture(scope="module")
def section(experiment, pressed):
    return section_of(experiment, pressed)


def test_surfaces_are_the_coat_and_the_specimen_under_it(experiment, pressed):
    """Why: the foremost point of the specimen touches the elastomer, a thickness below the coat."""
    coat, specimen = coat_surface(pressed), specimen_surface(experiment.specimen)
    assert coat.vertices_mm[:, 2].max() == pytest.approx(pressed.face_z_mm.max())
    assert coat.rgb.shape == coat.vertices_mm.shape
    assert specimen.vertices_mm[:, 2].max() == pytest.approx(0.0, abs=0.01)
    touched_mm = pressed.face_z_mm.max() - experiment.elastomer.thickness_mm
    assert front_mm(experiment, pressed) == pytest.approx(touched_mm, abs=0.5)


def test_the_section_goes_through_both_apexes(experiment, pressed, section):
    front = front_mm(experiment, pressed)
    assert np.nanmax(section.specimen_mm) == pytest.approx(front, abs=1e-3)
    assert section.coat_mm.max() == pytest.approx(pressed.face_z_mm.max(), abs=2e-3)
    thickness_mm = section.coat_mm - section.touched_mm
    assert np.median(thickness_mm) == pytest.approx(experiment.elastomer.thickness_mm, rel=0.2)


def test_the_cut_surface_is_the_half_behind_the_section(experiment, pressed, section):
    coat = coat_surface(pressed)
    cut = behind(coat, section.trace)
    used = coat.vertices_mm[np.unique(cut.triangles)]
    assert used[:, 1].min() >= 0
    assert len(cut.triangles) == pytest.approx(len(coat.triangles) / 2, rel=0.05)


def test_devices_are_drawn_in_their_true_directions(experiment):
    for device, part in zip(
        devices(experiment), (experiment.camera, experiment.projector), strict=True
    ):
        assert device.distance_mm == pytest.approx(part.pose.standoff_mm)
        assert f"{part.pose.standoff_mm:.0f} mm" in device.label
        near = device.at(near_mm(experiment))
        assert np.linalg.norm(near) == pytest.approx(near_mm(experiment))
        polar_deg = np.rad2deg(np.arccos(near[2] / np.linalg.norm(near)))
        assert polar_deg == pytest.approx(part.pose.polar_deg, abs=1e-6)
        assert np.abs(device.field_mm[..., 2]).max() < 1e-9


def test_the_view_of_the_object_contains_the_devices_as_drawn(experiment):
    """Within 35 degrees of the middle of the view, whose default field is 75 degrees high."""
    view = viewpoints(experiment)["object"]
    eye, ahead = np.array(view.position), np.subtract(view.look_at, view.position)
    for device in devices(experiment):
        there = device.at(near_mm(experiment)) - eye
        cosine = there @ ahead / np.linalg.norm(there) / np.linalg.norm(ahead)
        assert np.rad2deg(np.arccos(cosine)) < 35


def test_the_viewer_of_the_section_is_in_front_of_the_part_that_is_cut_off(experiment, section):
    x, y, _ = viewpoints(experiment)["section"].position
    assert section.trace.offset(x, y) < 0


def test_the_height_scale_has_the_heights_of_the_coat(pressed):
    low, high = heights_mm(pressed)
    scale = height_scale(pressed)
    assert f"{low:.3f}" in scale
    assert f"{high:.3f}" in scale
    assert "mm" in scale


def test_the_error_scale_has_the_limit_of_the_map():
    deviation = Deviation(np.array([[-2.5, 2.5]]), np.ones((1, 2), bool))
    assert "+2.5" in deviation_scale(deviation)


def test_the_section_is_drawn_to_scale(section):
    drawn = section_drawing(section)
    coat, *_ = re.findall(r'polyline points="([^"]+)"', drawn)
    y = np.array([float(pair.split(",")[1]) for pair in coat.split()])
    assert len(y) == len(section.s_mm)
    assert np.corrcoef(y, section.coat_mm)[0, 1] == pytest.approx(-1, abs=1e-3)


def test_a_gap_of_the_section_is_not_bridged(section):
    specimen_mm = section.specimen_mm.copy()
    inside = np.flatnonzero(specimen_mm > section.touched_mm.min())
    before = section_drawing(section).count("<polyline")
    specimen_mm[inside[len(inside) // 4]] = np.nan
    cut = replace(section, specimen_mm=specimen_mm)
    assert section_drawing(cut).count("<polyline") == before + 1


def test_the_command_states_the_changed_values():
    text = command_line("my.toml", {"press.depth_mm": 0.8, "coating.base_albedo": 0.25}, 4)
    assert "twin measure my.toml" in text
    assert text.index("-s coating.base_albedo=0.25") < text.index("-s press.depth_mm=0.8")
    assert text.endswith("figures: camera.binning = 4")

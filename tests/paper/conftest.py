"""Two small cases with panels: a rod measured under the coat, and a synthetic ball under a gel."""

import numpy as np
import pytest

from reconstruction.photometric import HeightMap
from twin.config import load_experiment
from twin.optics.stack import Truth
from twin.paper.plan import RODS
from twin.pipeline.methods import measure
from twin.results.decoders import DecodedImage
from twin.results.parts import write_result
from twin.results.record import Colours, Measurement
from twin.results.score import score_heights

# 160 x 120 pixels over the whole field, three phase steps, one sample: seconds, not minutes.
SMALL = {
    "camera.width_px": 640,
    "camera.height_px": 480,
    "camera.pixel_pitch_um": 9.0,
    "camera.binning": 4,
    "patterns.steps": 3,
    "render.samples": 1,
    "render.bounce_paths": 1,
    "press.solver_pitch_mm": 0.4,
    "press.relief_pitch_mm": 0.05,
}
RADIUS_MM, APEX_MM = 4.0, 0.75


@pytest.fixture(scope="package")
def small_photographs():
    """Photographs of 40 x 30 pixels; another test checks their content."""
    from twin.paper import photographs

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photographs, "_SAMPLES", 1)
        patch.setattr(photographs, "_WIDTH_PX", 40)
        patch.setattr(photographs, "_HEIGHT_PX", 30)
        yield


@pytest.fixture(scope="package")
def measured_rod(mi):
    """Measurement of a rod."""
    return measure(load_experiment("examples/slab_rod", SMALL))


@pytest.fixture(scope="package")
def rod(measured_rod, small_photographs, tmp_path_factory):
    """Folder of a measured rod with panels. Not to be changed by tests."""
    folder = tmp_path_factory.mktemp("cases") / RODS[0] / "contact_fpp"
    folder.mkdir(parents=True)
    write_case(folder, measured_rod)
    return folder


@pytest.fixture(scope="package")
def ball(mi, small_photographs, tmp_path_factory):
    """Folder of a synthetic photometric measurement: a perfect cap on a flat gel."""
    folder = tmp_path_factory.mktemp("cases") / "ball" / "photometric_stereo"
    folder.mkdir(parents=True)
    sensor = load_experiment("paper/gelsight_two_balls")
    specimen = load_experiment("paper/ball").specimen
    carried = {"name": "ball", "specimen": specimen, "provenance": {}}
    write_case(folder, perfect_cap(sensor.model_copy(update=carried)))
    return folder


def write_case(folder, measured):
    """Write the files of a case, without its completeness."""
    from twin.paper.panels import panel_data_of, write_panel_data

    write_result(folder, "paper", measured.experiment, measured.metrics)
    write_panel_data(folder / "panels", panel_data_of(measured))


def perfect_cap(experiment, pitch_mm=0.1, shape=(120, 160)):
    """Heights on an exact sphere over a flat gel; the first ten rows are not measured."""
    rows, cols = shape
    x, y = np.meshgrid(
        (np.arange(cols) - (cols - 1) / 2) * pitch_mm, ((rows - 1) / 2 - np.arange(rows)) * pitch_mm
    )
    cap = np.sqrt(np.maximum(RADIUS_MM**2 - x**2 - y**2, 0.0)) - RADIUS_MM + APEX_MM
    z = np.maximum(cap, 0.0).astype(np.float32)
    reason = np.zeros(shape, np.uint8)
    reason[:10] = 1
    heights = HeightMap(z, np.zeros((2, *shape), np.float32), reason, pitch_mm)
    zero, all_of_it = np.zeros(shape, np.float32), np.ones(shape, bool)
    points = np.stack([x, y, z], axis=-1).astype(np.float32)
    upwards = np.broadcast_to(np.float32([0, 0, 1]), points.shape)
    truth = Truth(points, upwards, zero + 1, zero, zero, all_of_it, all_of_it)
    figures = {"completeness": 0.9, "good_share": 0.8, "z_rmse_um": 0.0}
    image = np.full((*shape, 3), 128, np.uint8)
    scored = score_heights(experiment, heights, truth)
    own = DecodedImage("table", "sdk_2024", heights, scored)
    return Measurement(
        experiment, Colours(image, {}, [own], own), truth, scored, figures, None, "", {}
    )

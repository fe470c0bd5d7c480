"""A measurement with fringes as a folder: reading gives the written values."""

import json

import numpy as np
import pytest

from twin.config import vary
from twin.pipeline import measure
from twin.report.measurement import summary_table, write_report
from twin.results.folder import as_stored, read_measurement, write_kept, write_measurement

TINY = {"camera.width_px": 240, "camera.height_px": 200, "render.bounces": 0}


@pytest.fixture(scope="module", params=["contact_fpp", "direct_fpp"])
def done(request, mi, base):
    return measure(vary(base, TINY | {"modality": request.param}))


@pytest.fixture(scope="module")
def folder(done, tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    write_measurement(folder, "measure", done)
    return folder


def test_a_record_comes_back(done, folder):
    again = read_measurement(folder)
    assert again.experiment == done.experiment
    assert (again.metrics, again.digest, again.versions) == (
        done.metrics, done.digest, dict(done.versions),
    )  # fmt: skip
    for name in ("world_mm", "sigma_z_mm", "reason"):
        stored, expected = getattr(again.points, name), getattr(done.points, name)
        np.testing.assert_array_equal(stored, expected)
    np.testing.assert_array_equal(again.truth.points_world_mm, done.truth.points_world_mm)
    np.testing.assert_array_equal(again.picture, done.picture)
    assert again.score.against_truth == done.score.against_truth
    assert again.pixel_mm == done.pixel_mm


def test_what_does_not_exist_is_absent(done, folder):
    """Frames are not kept in files; no elastomer is pressed onto a bare specimen; fringes are not
    seen in colours."""
    again, presses = read_measurement(folder), done.experiment.method.presses
    assert again.fringes.frames is None
    assert (again.pressed is not None) == (folder / "press.nc").is_file() == presses
    assert ("force_n" in json.loads((folder / "result.json").read_text())["metrics"]) == presses
    with pytest.raises(TypeError, match="no colours"):
        again.colours  # noqa: B018
    if not presses:
        with pytest.raises(TypeError, match="presses nothing"):
            again.press  # noqa: B018


def test_a_study_keeps_what_it_is_asked_for(done, tmp_path):
    write_kept(tmp_path, done, ("points",))
    names = {path.name for path in tmp_path.iterdir()}
    assert "reconstruction.nc" in names
    assert not {"capture", "press.nc", "result.json"} & names


@pytest.mark.parametrize("done", ["contact_fpp"], indirect=True)
def test_the_page_drawn_at_once_is_the_page_drawn_later(done, folder, tmp_path):
    """Expected: the same bytes from the arrays at hand as from those in the folder."""
    at_hand = as_stored(folder, done)
    assert summary_table(at_hand) == summary_table(read_measurement(folder))
    assert at_hand.object is done.object  # computed once for result.json and page
    pages = []
    for name, measured in (("at_once", at_hand), ("later", read_measurement(folder))):
        (tmp_path / name).mkdir()
        pages.append(write_report(folder, into=tmp_path / name, measured=measured).read_bytes())
    assert pages[0] == pages[1]

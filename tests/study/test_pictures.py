"""Pictures of cases: the maps of a measurement of the case, reduced."""

from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.pipeline import Memory, measure
from twin.results.record import SurfacePoints
from twin.study import pictures
from twin.study.pictures import pictures_of, read_picture, take_picture, write_picture
from twin.study.store import Store


def test_picture_is_of_the_measurement(mi, base):
    """A case of 160 x 120 pixels, which is not thinned: every pixel is that of `measure`."""
    taken, done = take_picture(base, Memory()), measure(base)
    points, truth = done.points, done.truth
    np.testing.assert_array_equal(taken.measured, points.valid)
    np.testing.assert_array_equal(taken.z_mm[taken.measured], points.world_mm[points.valid][:, 2])
    rmse_um = np.sqrt(np.mean(taken.error_um[taken.scored].astype(float) ** 2))
    assert rmse_um == pytest.approx(done.score.against_truth.z_rmse_um, rel=1e-5)
    assert taken.true_z_mm[1] == truth.points_world_mm[..., 2].max()
    assert taken.seen.max() > 150  # the automatic exposure's level


def test_large_pictures_are_thinned(base):
    """400 x 300 pixels become every second one; heights keep their values."""
    z_mm = np.tile(np.linspace(0, 0.2, 400), (300, 1))
    points = np.zeros((300, 400, 3))
    points[..., 2] = z_mm
    there = np.ones((300, 400), bool)
    done = SimpleNamespace(
        experiment=base,
        points=SurfacePoints(points, np.zeros((300, 400), np.uint8)),
        truth=SimpleNamespace(points_world_mm=0 * points, lit=there, depth_mm=there),
        picture=np.full((300, 400, 3), 90, np.uint8),
        pixel_mm=0.02,
    )
    taken = pictures.picture_of(done)
    assert taken.seen.shape == (150, 200, 3)
    np.testing.assert_allclose(taken.z_mm, z_mm[::2, ::2], atol=1e-7)
    np.testing.assert_allclose(taken.error_um, 1e3 * z_mm[::2, ::2], atol=1e-4)
    assert taken.width_mm == 8.0


def test_kept_whole_or_not_at_all(base, tmp_path):
    there = np.ones((4, 4), bool)
    flat = there.astype(np.float32)
    picture = pictures.CasePicture(
        there.astype(np.uint8), flat, there, flat, there, np.zeros(2), np.array(1.0)
    )
    path = tmp_path / "pictures" / "a.npz"
    assert read_picture(path) is None
    write_picture(path, picture)
    assert [file.name for file in path.parent.iterdir()] == ["a.npz"]
    np.testing.assert_array_equal(read_picture(path).z_mm, flat)
    path.write_bytes(path.read_bytes()[:200])
    assert read_picture(path) is None
    with pytest.raises(InputError, match="cannot be written"):
        write_picture(path / "below" / "b.npz", picture)


def test_other_versions_take_no_pictures(stored, study_of, tmp_path):
    """The table's figures are another version's: a picture by this one would not belong to them."""
    store, cases = stored(study_of({"path": "coating.base_albedo", "values": [0.3, 0.4]}))
    mark = store.folder / "store.json"
    mark.write_text(mark.read_text().replace('"mitsuba": "', '"mitsuba": "0.'))
    taken, failed = pictures_of(Store(store.folder), cases)
    assert not taken
    assert all("computed with mitsuba 0." in reason for reason in failed.values())

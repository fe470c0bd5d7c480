"""Specimens from height maps: heights are reproduced, and bad input gives one-line errors."""

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.netcdf import LabelledArrays, write_arrays
from twin import press
from twin.config import digest, load_experiment
from twin.specimens import height_above_lowest, shape_of
from twin.specimens.kinds.height_map import HeightMapFile

PIXEL_MM = 0.1
X_MM, Y_MM = (np.arange(n) - (n - 1) / 2 for n in (61, 41))
X_MM, Y_MM = X_MM * PIXEL_MM, Y_MM * PIXEL_MM


def paraboloid_mm() -> np.ndarray[Any, Any]:
    """Heights (row, col), first row at +y; its vertex is at x = 0.5, y = 0.3 mm."""
    return -((X_MM - 0.5) ** 2 + (Y_MM[::-1, None] - 0.3) ** 2) / 16


def npy(folder: Path, values: Any, name: str = "map.npy") -> str:
    np.save(folder / name, values)
    return str(folder / name)


def test_a_paraboloid_comes_back(tmp_path: Path) -> None:
    specimen = HeightMapFile(file=npy(tmp_path, paraboloid_mm()), pixel_mm=PIXEL_MM)
    at_nodes = height_above_lowest(specimen, X_MM, Y_MM)
    np.testing.assert_allclose(at_nodes, -paraboloid_mm()[::-1], atol=1e-12)
    x, y = np.linspace(-2.5, 2.5, 37), np.linspace(-1.5, 1.5, 29)
    between = height_above_lowest(specimen, x, y)
    # A chord over a pixel's diagonal departs by at most diagonal^2 / 8 times the curvature, 1 / 8.
    exact = ((x - 0.5) ** 2 + (y[:, None] - 0.3) ** 2) / 16
    np.testing.assert_allclose(between, exact, atol=2 * PIXEL_MM**2 / 64)
    assert np.isinf(height_above_lowest(specimen, np.array([3.1]), np.array([0.0]))).all()


def test_the_body_is_closed_and_stands_on_its_base(tmp_path: Path) -> None:
    file = npy(tmp_path, paraboloid_mm().astype(np.float32))
    shape = shape_of(HeightMapFile(file=file, pixel_mm=PIXEL_MM, base_mm=1.5, yaw_deg=90))
    mesh = shape.mesh(0.0)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert shape.bounds_mm() == pytest.approx((-2.0, 2.0, -3.0, 3.0))
    assert shape.bottom_mm == pytest.approx(paraboloid_mm().min() - 1.5, abs=1e-6)


def test_integers_are_scaled(tmp_path: Path) -> None:
    levels = np.round((paraboloid_mm() + 2.0) * 10_000).astype(np.uint16)
    imageio.imwrite(tmp_path / "map.png", levels)
    file = str(tmp_path / "map.png")
    specimen = HeightMapFile(file=file, pixel_mm=PIXEL_MM, unit_mm=1e-4)
    height = height_above_lowest(specimen, X_MM, Y_MM)
    np.testing.assert_allclose(height, -paraboloid_mm()[::-1], atol=1e-4)
    with pytest.raises(InputError, match=r"^specimen\.unit_mm: missing; .*integers \(uint16\)"):
        shape_of(HeightMapFile(file=file, pixel_mm=PIXEL_MM))


def test_netcdf_maps_are_named_and_have_units(tmp_path: Path) -> None:
    file = tmp_path / "map.nc"
    maps = {
        name: (("row", "col"), paraboloid_mm() * 1e3, {"units": "um"}) for name in ("z", "other")
    }
    write_arrays(file, LabelledArrays(maps))
    given: dict[str, Any] = {"file": str(file), "pixel_mm": PIXEL_MM}
    with pytest.raises(InputError, match=r"variable: found no name, allowed: z, other"):
        shape_of(HeightMapFile(**given))
    with pytest.raises(InputError, match=r"variable: found 'y', allowed: z, other"):
        shape_of(HeightMapFile(**given, variable="y"))
    with pytest.raises(InputError, match=r"^specimen\.unit_mm: missing; .* the unit 'um'"):
        shape_of(HeightMapFile(**given, variable="z"))
    height = height_above_lowest(HeightMapFile(**given, variable="z", unit_mm=1e-3), X_MM, Y_MM)
    np.testing.assert_allclose(height, -paraboloid_mm()[::-1], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((3, 4, 2)), r"found float64 of shape \(3, 4, 2\), allowed numbers \(row, col\)"),
        (np.zeros((1, 40)), r"found float64 of shape \(1, 40\)"),
        (np.zeros((4, 4), np.complex128), r"found complex128"),
        (np.full((4, 4), np.nan), "found heights that are no numbers"),
        (
            np.diag(np.full(4, 200.0)),
            r"unit_mm: .* a relief of 200 mm, allowed up to 100",
        ),
        (np.zeros((2, 20_000)), r"specimen\.pixel_mm: found 0\.1, .* longest side 2e\+03 mm"),
        (np.zeros((2001, 2000), np.float32), r"found 2000 x 2001 px, allowed 4 million"),
    ],
)
def test_what_is_no_height_map_is_one_line(tmp_path: Path, values: Any, message: str) -> None:
    specimen = HeightMapFile(file=npy(tmp_path, values), pixel_mm=PIXEL_MM)
    with pytest.raises(InputError, match=message) as caught:
        shape_of(specimen)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("map.txt", b"1 2", r"no height map, allowed: \.png"),
        ("map.png", b"\x89PNG", "is no complete image"),
        ("map.npy", b"\x93NUMPY", "is no complete image"),
        ("map.nc", b"CDF", r"map\.nc"),
        ("", b"", "found no file there"),
    ],
)
def test_damaged_files_are_one_line(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    if name:
        (tmp_path / name).write_bytes(content)
    specimen = HeightMapFile(file=str(tmp_path / (name or "map.png")), pixel_mm=PIXEL_MM)
    with pytest.raises(InputError, match=message) as caught:
        shape_of(specimen)
    assert str(caught.value).startswith("specimen.file: ")
    assert "\n" not in str(caught.value)


def test_the_digest_counts_the_heights(tmp_path: Path) -> None:
    base = load_experiment("examples/starter")
    file = npy(tmp_path, paraboloid_mm())
    specimen = HeightMapFile(file=file, pixel_mm=PIXEL_MM)
    before = digest(base.model_copy(update={"specimen": specimen}))
    copy = npy(tmp_path, paraboloid_mm(), "copy.npy")
    moved = HeightMapFile(file=copy, pixel_mm=PIXEL_MM)
    assert digest(base.model_copy(update={"specimen": moved})) == before
    npy(tmp_path, 2 * paraboloid_mm())
    assert digest(base.model_copy(update={"specimen": specimen})) != before


def test_a_cap_is_pressed_like_the_ball(tmp_path: Path) -> None:
    """Setup: a ball of 4 mm radius as heights on 20 um pixels, under a slab with air behind it.

    Expected: the coated face within 0.1 um: chords depart by 0.013 um, eight times that at flanks.
    """
    across = (np.arange(381) - 190) * 0.02
    cap = np.sqrt(np.maximum(16.0 - across**2 - across[:, None] ** 2, 0.01))
    coarse = {"press.solver_pitch_mm": 0.2, "press.relief_pitch_mm": 0.05, "press.depth_mm": 0.3}
    ball = load_experiment("examples/slab_ball", coarse)
    specimen = HeightMapFile(file=npy(tmp_path, cap), pixel_mm=0.02)
    first, second = press(ball), press(ball.model_copy(update={"specimen": specimen}))
    np.testing.assert_allclose(first.face_z_mm, second.face_z_mm, atol=1e-4)
    assert first.force_n == pytest.approx(second.force_n, rel=1e-5)

"""Rods, punches, gratings, mesh files and groups: height field and mesh have the same geometry."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from reconstruction.errors import InputError
from twin.config.models import Specimen
from twin.specimens import height_above_lowest, shape_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.mesh import MeshFile
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.two_balls import TwoBalls
from twin.specimens.meshes import upper_side

X = np.linspace(-9.03, 9.07, 182)
Y = np.linspace(-8.04, 8.02, 161)

SPECIMENS: list[Specimen] = [
    Rod(),
    Rod(diameter_mm=2, length_mm=14, yaw_deg=30, x_mm=0.5),
    Rod(tilt_deg=12, yaw_deg=-50, edge_radius_mm=0.0),
    Rod(tilt_deg=25, edge_radius_mm=1.0, length_mm=6),
    Flat(),
    Flat(edge_radius_mm=0.0, tilt_deg=3),
    Flat(edge_radius_mm=1.0, tilt_deg=-10, yaw_deg=70, y_mm=1),
    Grating(),
    Grating(pitch_mm=2, yaw_deg=40, tilt_deg=2),
    Group(parts={"left": Ball(x_mm=-5, diameter_mm=4), "right": Rod(x_mm=4, length_mm=6)}),
    Group(
        parts={"low": Ball(x_mm=-3, z_mm=-0.3), "high": Flat(x_mm=4, diameter_mm=4)},
        tilt_deg=5,
        yaw_deg=20,
    ),
]


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda s: s.kind)
def test_height_field_is_the_upper_side_of_the_closed_mesh(specimen: Specimen) -> None:
    mesh = shape_of(specimen).mesh(-2.5)
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.bounds[1, 2] == pytest.approx(-2.5, abs=2e-3)
    height = height_above_lowest(specimen, X, Y)
    cast = -2.5 - upper_side(np.asarray(mesh.triangles), X, Y)
    both = np.isfinite(height) & np.isfinite(cast)
    # The mesh's outline is a polygon: single cells at the outline may differ.
    assert (np.isfinite(height) != np.isfinite(cast)).sum() <= 0.01 * both.sum()
    error = np.abs(height[both] - cast[both])
    assert np.quantile(error, 0.9) < 3e-3
    # Steep sides: the chord's error is divided by the slope's cosine.
    assert error.max() < 0.25


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda s: s.kind)
def test_foremost_point_is_zero_and_the_outline_holds_everything(specimen: Specimen) -> None:
    height = height_above_lowest(specimen, X, Y)
    assert 0 <= height.min() < 0.02
    x_low, x_high, y_low, y_high = shape_of(specimen).bounds_mm()
    rows, cols = np.nonzero(np.isfinite(height))
    assert x_low <= X[cols].min() < X[cols].max() <= x_high
    assert y_low <= Y[rows].min() < Y[rows].max() <= y_high
    bounds = shape_of(specimen).mesh(0.0).bounds[:, :2].T.ravel()
    np.testing.assert_allclose(bounds, (x_low, x_high, y_low, y_high), atol=3e-3)


def test_a_rod_is_a_cylinder_along_x() -> None:
    height = height_above_lowest(Rod(diameter_mm=4.0, length_mm=10.0), X, Y)
    middle = np.abs(X) < 4.7
    inside = np.abs(Y) < 2
    expected = 2 - np.sqrt(4 - Y[inside] ** 2)
    profile = height[inside][:, middle]
    np.testing.assert_allclose(
        profile, np.broadcast_to(expected[:, None], profile.shape), atol=1e-8
    )
    assert np.isinf(height[:, np.abs(X) > 5]).all()


def test_tilt_lifts_the_plus_x_side_of_every_kind() -> None:
    for specimen in (Rod(tilt_deg=5), Flat(tilt_deg=5), Grating(tilt_deg=5), TwoBalls(tilt_deg=5)):
        height = height_above_lowest(specimen, np.array([-2.5, 2.5]), np.array([0.0]))[0]
        assert height[1] < height[0] - 0.2


def test_a_punch_is_flat_up_to_its_rounding() -> None:
    height = height_above_lowest(Flat(diameter_mm=6, edge_radius_mm=0.5), X, Y)
    r = np.hypot(X, Y[:, None])
    np.testing.assert_allclose(height[r < 2.5], 0, atol=1e-9)
    edge = (r > 2.5) & (r < 2.99)
    np.testing.assert_allclose(height[edge], 0.5 - np.sqrt(0.25 - (r[edge] - 2.5) ** 2), atol=1e-8)
    assert np.isinf(height[r > 3]).all()


def test_parts_of_a_group_keep_their_own_height_and_balls() -> None:
    group = Group(
        parts={"a": Ball(x_mm=-4, diameter_mm=4), "b": Ball(x_mm=4, diameter_mm=6, z_mm=-0.5)}
    )
    first, second = shape_of(group).spheres()
    assert (first.x_mm, first.apex_z_mm) == pytest.approx((-4, 0))
    assert (second.x_mm, second.apex_z_mm) == pytest.approx((4, -0.5))
    at = height_above_lowest(group, np.array([-4.0, 4.0]), np.array([0.0]))[0]
    np.testing.assert_allclose(at, [0, 0.5], atol=1e-12)


def test_a_group_of_one_is_that_one() -> None:
    single, grouped = Rod(yaw_deg=20, x_mm=1), Group(parts={"only": Rod(yaw_deg=20, x_mm=1)})
    np.testing.assert_allclose(
        height_above_lowest(grouped, X, Y), height_above_lowest(single, X, Y), atol=1e-12
    )


def test_grid_lines_may_come_in_any_order() -> None:
    order = np.random.default_rng(0).permutation(X.size)
    height = height_above_lowest(Grating(), X, Y)
    np.testing.assert_array_equal(
        height_above_lowest(Grating(), X[order], Y[::-1]), height[::-1, order]
    )


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@pytest.mark.parametrize("up", ["+z", "-z", "+x", "-x", "+y", "-y"])
def test_a_mesh_file_faces_the_elastomer_with_its_chosen_axis(
    suffix: str, up: str, tmp_path: Path
) -> None:
    # A cone with its tip along the chosen axis of the file, in micrometres.
    cone = trimesh.creation.cone(radius=3000.0, height=4000.0, sections=64)
    axis = dict(zip("xyz", np.eye(3), strict=True))[up[1]] * (1 if up[0] == "+" else -1)
    cone.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], axis))
    path = tmp_path / f"cone{suffix}"
    cone.export(path)
    specimen = MeshFile.model_validate({"file": str(path), "up": up, "scale": 1e-3})
    at = height_above_lowest(specimen, np.array([0.0, 1.5, 3.5]), np.array([0.0]))[0]
    np.testing.assert_allclose(at[:2], [0, 2], atol=2e-2)
    assert np.isinf(at[2])


def test_a_ball_from_a_file_is_the_ball(tmp_path: Path) -> None:
    path = tmp_path / "ball.stl"
    trimesh.creation.icosphere(subdivisions=6, radius=4.0).export(path)
    height, known = (
        height_above_lowest(s, X, Y) for s in (MeshFile(file=str(path), x_mm=1), Ball(x_mm=1))
    )
    near = known < 2
    np.testing.assert_allclose(height[near], known[near], atol=1e-3)


def test_an_open_mesh_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "open.stl"
    box = trimesh.creation.box((4, 4, 4))
    trimesh.Trimesh(box.vertices, box.faces[:-1]).export(path)
    with pytest.raises(InputError, match=r"open\.stl: not watertight \(3 open edges\)") as caught:
        shape_of(MeshFile(file=str(path)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.stl", None, "no such file"),
        ("text.txt", b"hello", r"allowed: \.stl, \.ply, \.obj"),
        ("bad.ply", b"hello", "cannot be read|no triangles"),
        ("empty.stl", b"solid x\nendsolid x\n", "cannot be read|no triangles"),
    ],
)
def test_useless_files_are_refused(
    name: str, content: bytes | None, message: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        shape_of(MeshFile(file=str(path)))
    assert "\n" not in str(caught.value)


def test_an_edge_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValidationError, match="half the smaller"):
        Flat(diameter_mm=2, edge_radius_mm=1.5)
    with pytest.raises(ValidationError, match="half the smaller"):
        Rod(length_mm=1, edge_radius_mm=0.6)

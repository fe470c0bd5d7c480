"""A film of its own stiffness: the single layer, the plate and the membrane as its limits."""

import numpy as np
import pytest

from twin.config.models import Elastomer, Film, Press
from twin.mechanics import contact_transfer, press
from twin.mechanics.transfer import (
    SMALLEST_Q,
    CoatFilm,
    LoadedBase,
    amplitudes,
    solve_coated,
    solve_transfer,
)
from twin.specimens.kinds.ball import Ball

Q = np.geomspace(SMALLEST_Q, 45, 200)
COLUMNS = ("normal_t", "normal_b", "tangential_t", "tangential_b")


@pytest.mark.parametrize("base", ["bonded", "free", "free_turned"])
@pytest.mark.parametrize("share", [0.001, 0.02, 0.3, 0.7])
@pytest.mark.parametrize("nu", [0.3, 0.49, 0.5])
def test_a_film_of_the_slab_itself_is_the_single_layer(
    base: LoadedBase, share: float, nu: float
) -> None:
    single = solve_transfer(Q, nu, "bonded" if base == "bonded" else "free")
    coated = solve_coated(Q, nu, base, CoatFilm(share, 1.0, nu))
    for column in COLUMNS:
        expected = getattr(single, column)
        size = max(np.abs(single.normal_t).max(), 1.0)
        np.testing.assert_allclose(getattr(coated, column), expected, rtol=1e-6, atol=1e-9 * size)


def plate_on_layer(q: np.ndarray, nu: float, film: CoatFilm) -> np.ndarray:
    """Phi of a bonded layer under a Kirchhoff plate that also resists stretching.

    Plate, per unit shear modulus of the slab: bending D k^4, D = G t^3 / (6 (1 - nu_f)), and
    membrane 2 G t k^2 / (1 - nu_f), both at the interface: the film is thin.
    """
    slab = q * (1 - film.share)
    t = q * film.share  # k times film thickness
    bending = film.shear_ratio * t**3 / (6 * (1 - film.poisson_ratio))
    stretching = 2 * film.shear_ratio * t / (1 - film.poisson_ratio)
    top, bottom = amplitudes(slab, 0.0, nu), amplitudes(slab, 1.0, nu)
    per_k = slab[:, None]
    normal = top["S_zz"] / per_k - bending[:, None] * top["W"]
    shear = top["S_xz"] / per_k - stretching[:, None] * top["U"]
    rows = np.stack((normal, shear, bottom["U"], bottom["W"]), axis=-2)
    load = np.zeros((q.size, 4, 1))
    load[:, 0] = -1.0
    weights = np.linalg.solve(rows, load)[..., 0]
    return np.einsum("qi,qi->q", top["W"], weights) / (1 - nu)


def test_a_thin_stiff_film_is_a_plate_and_a_membrane() -> None:
    film, q = CoatFilm(share=0.002, shear_ratio=2e4, poisson_ratio=0.3), np.geomspace(0.05, 20, 60)
    result = solve_coated(q, 0.49, "bonded", film).normal_t
    assert result[-1] < 0.9  # a half-space would have 1
    # Half the film's thickness is between its middle and the interface.
    np.testing.assert_allclose(result, plate_on_layer(q, 0.49, film), rtol=2e-3)


def test_a_stiff_film_bends_the_free_slab_as_a_composite_plate() -> None:
    film = CoatFilm(share=0.1, shear_ratio=50.0, poisson_ratio=0.49)
    q = np.array([SMALLEST_Q])
    # Plane-strain moduli over the slab's E*, z from the touched face, thickness 1.
    moduli, edges = np.array([1.0, 50.0]), np.array([0.0, 0.9, 1.0])
    areas = moduli * np.diff(edges)
    neutral = (areas @ (edges[1:] + edges[:-1]) / 2) / areas.sum()
    bending = (moduli @ np.diff((edges - neutral) ** 3)) / 3
    # u = p / (D k^4) = 2 Phi p / (E* k)
    for base in ("free", "free_turned"):
        result = solve_coated(q, 0.49, base, film)
        assert result.normal_t[0] * 2 * bending * q[0] ** 3 == pytest.approx(1, rel=1e-3)


def test_loading_either_side_obeys_maxwell_and_betti() -> None:
    film = CoatFilm(share=0.05, shear_ratio=20.0, poisson_ratio=0.4)
    upright, turned = (solve_coated(Q, 0.49, base, film) for base in ("free", "free_turned"))
    np.testing.assert_allclose(upright.normal_b, turned.normal_b, rtol=1e-6, atol=1e-12)


def slab(layout: str, film: Film | None) -> Elastomer:
    return Elastomer.model_validate(
        {
            "thickness_mm": 3.0,
            "length_x_mm": 18.0,
            "length_y_mm": 18.0,
            "young_modulus_kpa": 300.0,
            "poisson_ratio": 0.49,
            "layout": layout,
            "film": film,
        }
    )


@pytest.mark.parametrize("layout", ["opposite_face", "contact_face"])
def test_a_film_of_the_slab_itself_changes_no_press(layout: str) -> None:
    load = Press(control="depth", depth_mm=0.5, solver_pitch_mm=0.2, relief_pitch_mm=0.05)
    film = Film(thickness_mm=0.05, young_modulus_kpa=300.0, poisson_ratio=0.49)
    plain, coated = (press(Ball(), slab(layout, own), load) for own in (None, film))
    assert coated.force_n == pytest.approx(plain.force_n, rel=1e-6)
    np.testing.assert_allclose(coated.face_z_mm, plain.face_z_mm, atol=1e-6)
    stiff = film.model_copy(update={"young_modulus_kpa": 30_000.0})
    assert press(Ball(), slab(layout, stiff), load).force_n > 1.05 * plain.force_n


def test_a_stiff_film_smooths_what_the_coat_shows() -> None:
    film = Film(thickness_mm=0.1, young_modulus_kpa=300_000.0)
    result = contact_transfer(slab("opposite_face", film), np.array([3.0]))
    assert result.computed[0] < 0.9 * result.closed_form[0]

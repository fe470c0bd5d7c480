"""Derivatives of a pressed sheet compared with new presses on its cells, and scaling laws."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from tests.mechanics.sheets import EXACT, build_sheet
from twin.config.models import Mechanics, Press
from twin.mechanics.errors import PressError
from twin.mechanics.sheet.energy import Sheet, System
from twin.mechanics.sheet.equilibrium import settle
from twin.mechanics.sheet.neighbour import Neighbourhood
from twin.mechanics.sheet.press import SettledSheet, settled_sheet
from twin.specimens.kinds.ball import Ball

MECHANICS = Mechanics.model_validate({"model": "sheet"})
NOMINAL = {
    "thickness_mm": 0.3,
    "young_modulus_kpa": 300.0,
    "back_pressure_kpa": 4.0,
    "depth_mm": 0.5,
    "diameter_mm": 5.0,
    "x_mm": 0.3,
}
OF_THE_SHEET = ("thickness_mm", "young_modulus_kpa", "pre_stretch", "tack_j_m2", "friction")


def data(**changes: object) -> tuple[object, ...]:
    """Return mechanics, specimen, elastomer and load with some numbers changed."""
    now = NOMINAL | changes
    elastomer = build_sheet(
        length_x_mm=10.0, length_y_mm=10.0, **{k: now[k] for k in OF_THE_SHEET if k in now}
    )
    control = {"control": "depth", "depth_mm": now["depth_mm"]}
    if "force_n" in now:
        control = {"control": "force", "force_n": now["force_n"]}
    load = {"relief_pitch_mm": 0.05, "cell_mm": 0.4, "back_pressure_kpa": now["back_pressure_kpa"]}
    specimen = Ball(diameter_mm=now["diameter_mm"], x_mm=now["x_mm"])
    return MECHANICS, specimen, elastomer, Press.model_validate(control | load)


def settled(**changes: object) -> SettledSheet:
    """Press as the product does, then close the equilibrium to the last digits."""
    mechanics, specimen, elastomer, load = data(**changes)
    rest = settled_sheet(specimen, elastomer, load, mechanics)  # type: ignore[arg-type]
    return replace(rest, state=settle(rest.sheet, rest.state, EXACT))


@pytest.fixture(scope="module")
def neighbourhood() -> Neighbourhood:
    return Neighbourhood(settled())


def derivative(neighbourhood: Neighbourhood, name: str, **base: object) -> tuple[np.ndarray, float]:
    """Return the derivatives of face and force by a parameter."""
    value = float((NOMINAL | base)[name])
    step = 1e-6 * value
    low, high = (neighbourhood.press(*data(**base | {name: value + by})) for by in (-step, step))
    return (
        (high.face_z_mm - low.face_z_mm) / (2 * step),
        (high.force_n - low.force_n) / (2 * step),
    )


def own_factors(sheet: Sheet) -> Sheet:
    """Return the sheet with a solver of its own."""
    alone = copy(sheet)
    alone.system = System.of(sheet.grid.free)
    return alone


@pytest.mark.parametrize("name", ["thickness_mm", "back_pressure_kpa", "depth_mm", "x_mm"])
def test_derivatives_are_differences_of_presses_on_the_same_cells(
    neighbourhood: Neighbourhood, name: str
) -> None:
    """Presses that differ by 0.4 %: points that start to touch between them cause some 1e-3."""
    step = 2e-3 * NOMINAL[name]
    ends = []
    for by in (-step, step):
        near = neighbourhood.neighbour(*data(**{name: NOMINAL[name] + by}))
        state = settle(own_factors(near.sheet), near.state, EXACT)
        ends.append(replace(near, state=state).result())
    face, force = derivative(neighbourhood, name)
    true = (ends[1].face_z_mm - ends[0].face_z_mm) / (2 * step)
    assert np.sqrt(np.mean((face - true) ** 2)) < 2e-3 * np.sqrt(np.mean(true**2))
    scale_n = ends[0].force_n / NOMINAL["depth_mm"]
    assert force == pytest.approx(
        (ends[1].force_n - ends[0].force_n) / (2 * step), abs=2e-3 * scale_n
    )


def test_only_pressure_over_modulus_counts(neighbourhood: Neighbourhood) -> None:
    """The shape is of degree 0 in both together, the force of degree 1 (Euler)."""
    parts = [derivative(neighbourhood, name) for name in ("young_modulus_kpa", "back_pressure_kpa")]
    values = NOMINAL["young_modulus_kpa"], NOMINAL["back_pressure_kpa"]
    faces = [value * face for value, (face, _) in zip(values, parts, strict=True)]
    assert np.abs(faces[0] + faces[1]).max() < 1e-5 * np.abs(faces[0]).max()
    force_n = sum(value * force for value, (_, force) in zip(values, parts, strict=True))
    assert force_n == pytest.approx(neighbourhood.rest.result().force_n, rel=1e-5)


def test_under_a_set_force_the_travel_goes_along(neighbourhood: Neighbourhood) -> None:
    """By the force: the derivative by the travel over the sheet's stiffness."""
    face, stiffness = derivative(neighbourhood, "depth_mm")
    force_n = neighbourhood.rest.result().force_n
    base = {"force_n": force_n}
    by_force, unit = derivative(neighbourhood, "force_n", **base)
    assert unit == pytest.approx(1.0, rel=1e-4)
    assert np.abs(by_force * stiffness - face).max() < 1e-3 * np.abs(face).max()
    _, unchanged = derivative(neighbourhood, "thickness_mm", **base)
    assert unchanged == pytest.approx(0.0, abs=1e-4 * force_n / NOMINAL["thickness_mm"])


def test_a_change_of_the_grid_is_rejected(neighbourhood: Neighbourhood) -> None:
    with pytest.raises(PressError, match="needs a new grid"):
        neighbourhood.press(*data(pre_stretch=1.05))


def test_a_sheet_that_sticks_has_no_derivative() -> None:
    mechanics, specimen, elastomer, load = data(friction="stick", back_pressure_kpa=1.0)
    rest = settled_sheet(specimen, elastomer, load, mechanics)  # type: ignore[arg-type]
    with pytest.raises(PressError, match=r"elastomer\.friction: found 'stick'"):
        Neighbourhood(rest)

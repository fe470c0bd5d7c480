"""The model of the experiment is used for the press; all models agree where they overlap."""

from importlib import import_module

import numpy as np
import pytest

from tests.mechanics.sheets import build_sheet
from twin.config import ConfigError, load_experiment
from twin.config.models import Mechanics, PadFile, Press
from twin.mechanics import PressError
from twin.mechanics.choice import check_press, press_with, select_model
from twin.mechanics.models import PressInput
from twin.mechanics.models.fem import read_pad
from twin.pipeline import press_specimen
from twin.specimens.kinds.ball import Ball


def pressed(name="examples/slab_balls", **changes):
    return press_specimen(
        load_experiment(name, {k.replace("__", "."): v for k, v in changes.items()})
    )


def test_fem_and_spectral_agree_on_the_papers_slab():
    """Two balls, free 3 mm slab on a simple rim: force within 1.5 %, coat within 5 um RMS."""
    free = {"press__back_pressure_kpa": 0.0}
    spectral = pressed(**free)
    fem = pressed(**free, mechanics__model="fem", mechanics__tetrahedra=2000)
    assert fem.force_n == pytest.approx(spectral.force_n, rel=0.015)
    np.testing.assert_array_equal(fem.face_x_mm, spectral.face_x_mm)
    difference_mm = fem.face_z_mm - spectral.face_z_mm
    assert np.sqrt(np.mean(difference_mm**2)) < 5e-3


def test_a_domed_pad_from_an_experiment_file():
    """End to end from STL: the coat is on the ball in the middle and on the dome outside.

    Expected too: no warning on the pad's sides, which are a part of the elements.
    """
    result = pressed("examples/domed_pad", mechanics__tetrahedra=800)
    row = np.abs(result.face_y_mm).argmin()
    middle, edge = (np.interp(x, result.face_x_mm, result.face_z_mm[row]) for x in (0.0, 5.5))
    assert middle == pytest.approx(0.5, abs=0.02)
    assert edge == pytest.approx(16 - np.sqrt(16**2 - 5.5**2), abs=0.05)
    assert result.force_n > 0
    assert not any("side" in line for line in result.validity.warnings)


def test_a_rectangle_beyond_a_round_pad_is_refused_before_it_is_solved():
    """Cap 4 mm high of a ball of 16 mm: a circle of 21.1 mm, in which a square of 14.9 mm fits."""
    wide = {"elastomer.length_x_mm": 30.0, "elastomer.length_y_mm": 30.0}
    case = load_experiment("examples/domed_pad", wide)
    message = r"found 30 x 30 mm, which reaches beyond .* about 14\.7 x 14\.7 mm"
    with pytest.raises(PressError, match=message):
        check_press(case.mechanics, case.specimen, case.elastomer, case.press)
    fits = load_experiment("examples/domed_pad", dict.fromkeys(wide, 14.7))
    check_press(fits.mechanics, fits.specimen, fits.elastomer, fits.press)


def case(ball_mm=8.0, depth_mm=0.2, pressure_kpa=0.0, gravity_deg=None, **sheet):
    """Return a ball, a sheet and a press."""
    load = {"control": "depth", "depth_mm": depth_mm, "back_pressure_kpa": pressure_kpa}
    load |= {"gravity_deg": gravity_deg, "cell_mm": 0.3, "relief_pitch_mm": 0.05}
    return Ball(diameter_mm=ball_mm), build_sheet(**sheet), Press.model_validate(load)


@pytest.mark.parametrize(
    ("keys", "model"),
    [
        ({"thickness_mm": 3.0}, "spectral"),
        # It rises by less than 0.4 thicknesses.
        ({"thickness_mm": 1.0, "depth_mm": 0.2}, "spectral"),
        # h / (R + h / 2) = 0.22
        ({"thickness_mm": 1.0, "depth_mm": 0.9}, "sheet"),
        ({"thickness_mm": 1.2, "depth_mm": 1.0}, "neo_hookean"),
        # 0.25, the limit of a sheet.
        ({"thickness_mm": 1.0, "depth_mm": 0.9, "ball_mm": 7.0}, "sheet"),
        # Too thick a sheet for a ball of R 2.5: 0.33.
        ({"thickness_mm": 1.0, "depth_mm": 0.9, "ball_mm": 5.0}, "neo_hookean"),
        # Solid elements have neither weight nor back pressure.
        (
            {"thickness_mm": 1.2, "depth_mm": 1.0, "density_kg_m3": 1e3, "gravity_deg": 0.0},
            "spectral",
        ),
        ({"thickness_mm": 1.5, "depth_mm": 0.8, "pressure_kpa": 0.5}, "spectral"),
        ({"thickness_mm": 1.0, "depth_mm": 0.9, "ball_mm": 5.0, "pressure_kpa": 0.5}, "sheet"),
        ({"thickness_mm": 1.0, "depth_mm": 0.9, "layout": "contact_face"}, "spectral"),
    ],
)
def test_auto_takes_the_model_of_the_least_error(keys, model):
    assert select_model(PressInput(Mechanics(), *case(**keys))).name == model


@pytest.mark.parametrize(
    ("keys", "wraps"),
    [
        ({}, False),
        ({"depth_mm": 0.3}, True),
        ({"tack_j_m2": 0.1}, True),
        ({"friction": "stick"}, True),
        ({"pre_stretch": 1.1}, True),
        ({"outline": "round"}, True),
        ({"thickness_mm": 1.1, "depth_mm": 1.1}, False),
        ({"thickness_mm": 1.1, "tack_j_m2": 0.1}, False),
        ({"layout": "contact_face", "depth_mm": 0.3}, False),
    ],
)
def test_some_cases_are_the_sheets_before_anything_is_solved(keys, wraps, monkeypatch):
    def solves(*_, **__):
        raise AssertionError("the linear slab was solved")

    module = import_module("twin.mechanics.press")  # a function of the package has this name
    monkeypatch.setattr(module, "solve_on_layer", solves)
    if wraps:
        assert select_model(PressInput(Mechanics(), *case(**keys))).name == "sheet"
    else:
        with pytest.raises((AssertionError, PressError)):
            press_with(Mechanics(), *case(**keys))


@pytest.mark.parametrize("keys", [{"depth_mm": 0.4}, {"depth_mm": 0.25}])
def test_auto_presses_thin_sheets_as_sheets(keys):
    """Deeper than it is thick, and less deep but bent by more than 0.4 thicknesses."""
    small = {"length_x_mm": 10.0, "length_y_mm": 10.0}
    result = press_with(Mechanics(), *case(**keys, **small))
    assert result.model == "sheet"
    assert result.sheet is not None


@pytest.mark.parametrize(
    ("key", "value"),
    [("tack_j_m2", 0.1), ("friction", "stick"), ("pre_stretch", 1.2), ("outline", "round")],
)
@pytest.mark.parametrize("model", ["spectral", "neo_hookean"])
def test_other_models_refuse_what_only_the_sheet_knows(key, value, model):
    keys = {f"elastomer.{key}": value, "elastomer.length_x_mm": 20.0, "mechanics.model": model}
    with pytest.raises(PressError, match=rf"^elastomer\.{key}: .* the {model} model") as caught:
        press_specimen(load_experiment("examples/slab_balls", keys))
    assert "\n" not in str(caught.value)


def test_solid_elements_travel_farther_than_the_slab_is_thick():
    deep = case(thickness_mm=1.2, depth_mm=1.3)
    check_press(Mechanics(model="neo_hookean"), *deep)
    for model in ("spectral", "auto"):
        with pytest.raises(PressError, match=r"^press\.depth_mm: 1\.3 mm is not less than"):
            check_press(Mechanics(model=model), *deep)


def test_supports_and_pads_belong_to_fem_and_sheet():
    for model in ("spectral", "neo_hookean"):
        with pytest.raises(ConfigError, match="support needs model = 'fem'"):
            load_experiment(
                "examples/slab_balls", {"mechanics.support": "clamped", "mechanics.model": model}
            )
    ledge = Mechanics(model="sheet", support="ledge")
    with pytest.raises(PressError, match=r"^mechanics\.support: found 'ledge', .*'simple' or"):
        press_with(ledge, *case())


def test_pads_that_cannot_be_read_are_one_line(tmp_path):
    on_window = load_experiment("examples/domed_pad").elastomer
    slab = load_experiment("examples/slab_balls").elastomer
    with pytest.raises(PressError, match="contact_face"):
        read_pad(PadFile(file="scenes/examples/dome.stl"), slab)
    with pytest.raises(ValueError, match=r"mechanics\.pad\.file: nowhere\.stl: no such file"):
        read_pad(PadFile(file="nowhere.stl"), on_window)
    (tmp_path / "text.stl").write_text("no mesh")
    with pytest.raises(ValueError, match=r"mechanics\.pad\.file"):
        read_pad(PadFile(file=str(tmp_path / "text.stl")), on_window)

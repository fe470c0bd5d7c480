"""The model that the experiment asks for is the one that presses; all agree where they overlap."""

import numpy as np
import pytest

from twin.config import ConfigError, load_experiment
from twin.config.models import PadFile
from twin.mechanics import PressError
from twin.mechanics.choice import choose_model, read_pad
from twin.modalities import press_specimen


def pressed(name="paper/two_balls", **changes):
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
    """End to end from STL: the coat lies on the ball in the middle and on the dome outside."""
    found = pressed("examples/domed_pad", mechanics__tetrahedra=800)
    row = np.abs(found.face_y_mm).argmin()
    middle, edge = (np.interp(x, found.face_x_mm, found.face_z_mm[row]) for x in (0.0, 5.5))
    assert middle == pytest.approx(0.5, abs=0.02)
    assert edge == pytest.approx(16 - np.sqrt(16**2 - 5.5**2), abs=0.05)
    assert found.force_n > 0


def test_auto_takes_the_large_strain_model_only_for_thin_sheets():
    free = {"press.back_pressure_kpa": 0.0}
    thick = load_experiment("paper/two_balls", free)
    thin = load_experiment(
        "paper/two_balls", free | {"elastomer.thickness_mm": 1.0, "press.depth_mm": 0.9}
    )
    for experiment, wanted in ((thick, "spectral"), (thin, "neo_hookean")):
        linear = press_specimen(
            load_experiment(
                "paper/two_balls",
                free
                | {
                    "elastomer.thickness_mm": experiment.elastomer.thickness_mm,
                    "press.depth_mm": experiment.press.depth_mm,
                    "mechanics.model": "spectral",
                },
            )
        )
        assert choose_model(linear, experiment.elastomer, experiment.press) == wanted


def test_draped_sheets_stay_spectral():
    """Back pressure is what the large-strain model does not know."""
    experiment = load_experiment(
        "examples/pressurised", {"elastomer.thickness_mm": 1.5, "mechanics.model": "spectral"}
    )
    linear = press_specimen(experiment)
    assert linear.validity.deflection_over_thickness > 0.4
    assert choose_model(linear, experiment.elastomer, experiment.press) == "spectral"


def test_supports_and_pads_belong_to_fem():
    with pytest.raises(ConfigError, match="support needs model = 'fem'"):
        load_experiment("paper/two_balls", {"mechanics.support": "clamped"})


def test_pads_that_cannot_be_read_are_one_line(tmp_path):
    on_window = load_experiment("examples/domed_pad").elastomer
    slab = load_experiment("paper/two_balls").elastomer
    with pytest.raises(PressError, match="contact_face"):
        read_pad(PadFile(file="scenes/examples/dome.stl"), slab)
    with pytest.raises(ValueError, match=r"mechanics\.pad\.file: nowhere\.stl: no such file"):
        read_pad(PadFile(file="nowhere.stl"), on_window)
    (tmp_path / "text.stl").write_text("no mesh")
    with pytest.raises(ValueError, match=r"mechanics\.pad\.file"):
        read_pad(PadFile(file=str(tmp_path / "text.stl")), on_window)

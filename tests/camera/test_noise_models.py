"""Kinds of camera noise: the default is drawn by the compiled kernel, others by their function."""

from typing import Any

import numpy as np
import pytest

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise
from twin.camera import electrons_per_ms, expose, noise_model, read_noise_e
from twin.config import load_experiment
from twin.config.models import Experiment
from twin.config.noise_models import NOISE_MODELS, NoiseModel
from twin.pipeline.fringes import noise_warnings

SHAPE = (200, 200)
LEVELS_E = (0.0, 50.0, 2000.0)


class Plain(NoiseModel):
    """Noise of EMVA 1288 by numpy's generators."""

    kind: str = "plain"


class Offset(NoiseModel):
    """The mean plus a constant number of read noises: no random numbers."""

    kind: str = "offset"
    sigmas: float = 3.0

    def electrons(
        self, mean_e: FloatImage, rng: np.random.Generator, sensor: SensorNoise
    ) -> FloatImage:
        return mean_e + np.float32(self.sigmas * sensor.read_noise_e)


class Flat(NoiseModel):
    kind: str = "flat"

    def electrons(self, mean_e: Any, rng: Any, sensor: Any) -> Any:
        return mean_e[0]


def with_noise(model: NoiseModel, **changes: object) -> Experiment:
    plain = {"exposure_ms": 10.0, "prnu_percent": 0.0, "dsnu_e": 0.0} | changes
    case = load_experiment("examples/slab_balls", {f"camera.{k}": v for k, v in plain.items()})
    camera = case.camera.model_copy(update={"noise_model": model})
    return case.model_copy(update={"camera": camera})


def frames(case: Experiment) -> list[FloatImage]:
    """Uniform frames of `LEVELS_E` electrons per pixel."""
    rate = 10.0 * electrons_per_ms(case.camera, case.projector.wavelength_nm)
    return [np.full(SHAPE, electrons / rate, np.float32) for electrons in LEVELS_E]


def test_the_default_is_emva_1288_and_in_no_file() -> None:
    camera = load_experiment("examples/slab_balls").camera
    assert camera.noise_model == NOISE_MODELS["emva1288"]()
    assert "noise_model" not in camera.model_dump()


def test_the_base_class_has_the_statistics_of_the_compiled_kernel() -> None:
    """40,000 pixels: means within 5 standard errors (spread / 200) of both, spreads within 2 %."""
    case = with_noise(Plain())
    drawn, compiled = (
        expose(each, frames(case), 2).stack.astype(float)
        for each in (case, with_noise(NOISE_MODELS["emva1288"]()))
    )
    for mine, theirs in zip(drawn, compiled, strict=True):
        assert mine.mean() == pytest.approx(theirs.mean(), abs=5 * 1.5 * theirs.std() / 200)
        assert mine.std() == pytest.approx(theirs.std(), rel=0.02)


def test_an_offset_by_hand() -> None:
    """Three read noises of a binned pixel, in digital numbers by the gain; trials are the same."""
    case = with_noise(Offset(), dark_current_e_per_s=0.0)
    sensor = noise_model(case.camera)
    assert sensor.read_noise_e == read_noise_e(case.camera)
    levels_e = np.array(LEVELS_E) + 3.0 * sensor.read_noise_e
    expected = np.rint(sensor.gain_dn_per_e * levels_e + sensor.black_level_dn)
    for trial in (0, 1):
        stack = expose(case, frames(case), 2, trial=trial).stack
        np.testing.assert_array_equal(stack[:, 0, 0], expected)


def test_random_numbers_follow_experiment_trial_and_frame() -> None:
    case = with_noise(Plain())
    first, again, reseeded = (expose(case, frames(case), 2, trial=n).stack for n in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != reseeded).mean() > 0.3


def test_without_noise_and_for_a_function_the_kind_is_not_used() -> None:
    emva = NOISE_MODELS["emva1288"]()
    for changes, noise in (({"noise": False}, None), ({}, lambda mean_e, rng: mean_e)):
        own, default = (
            expose(with_noise(model, **changes), frames(with_noise(model)), 2, noise=noise).stack
            for model in (Offset(), emva)
        )
        np.testing.assert_array_equal(own, default)


def test_electrons_of_another_shape_are_rejected_with_the_kind() -> None:
    case = with_noise(Flat())
    with pytest.raises(InputError, match=r"noise: flat returned the shape \(200,\)"):
        expose(case, frames(case), 2)


def test_a_warning_names_the_kind() -> None:
    (warning,) = noise_warnings(with_noise(Offset()), None)
    assert warning.startswith("camera noise of the kind offset; standard deviations")
    assert noise_warnings(with_noise(Offset(), noise=False), None) == []
    assert noise_warnings(with_noise(NOISE_MODELS["emva1288"]()), None) == []

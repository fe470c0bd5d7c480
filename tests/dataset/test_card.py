"""Data card: distributions in words, how to read the data set, scales of the histograms."""

import re

import numpy as np
import pytest

from tests.dataset.conftest import MadeSet
from twin.config.axis import Axis
from twin.config.inputs import Input
from twin.dataset.make import pack
from twin.dataset.taking import SAMPLE_FOLDER
from twin.report.dataset_card import card_text, distribution_of_axis, distribution_of_input
from twin.report.dataset_pictures import draw_distributions, logarithmic
from twin.study.store import Store


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        (
            {"low": 0, "high": 4294967295, "integer": True},
            "whole numbers, uniform from 0 to 42949672",
        ),
        ({"low": 0.5, "high": 20.0, "scale": "log"}, "log-uniform from 0.5 to 20"),
        ({"values": [0.2, 0.3]}, "0.2, 0.3, equally probable"),
        ({"low": 1.0, "high": 2.0, "count": 10}, "and 4 more, equally probable"),
        ({"values": ["/a/b.stl", "/a/c.stl"]}, "b.stl, c.stl, equally probable"),
    ],
)
def test_axes_in_words(axis: dict, words: str) -> None:
    assert words in distribution_of_axis(Axis(path="specimen.x_mm", **axis))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"distribution": "normal", "spread": 0.5},
            "nominal value of the scene, standard deviation 0.5",
        ),
        (
            {"distribution": "normal", "spread": 0.02, "relative": True},
            "deviation 2 % of the nominal",
        ),
        (
            {"distribution": "normal", "spread": 1, "at_least": 0.0},
            "deviation 1, cut off: at least 0",
        ),
        (
            {"distribution": "arcsine", "spread": 2},
            "arcsine about the nominal value of the scene, half",
        ),
        (
            {"distribution": "student_t", "spread": 1, "degrees_of_freedom": 4},
            "student t about the nominal value of the scene, scale 1, 4 degrees of freedom",
        ),
        ({"distribution": "choice", "values": (5.0, 6.5)}, "5, 6.5, equally probable"),
        (
            {"distribution": "choice", "values": (5, 6), "weights": (1, 3)},
            "5, 6, with weights 1, 3",
        ),
    ],
)
def test_inputs_in_words(given: dict, words: str) -> None:
    assert words in distribution_of_input(Input(group="optics", key="camera.gain", **given))


def test_the_lines_of_the_card_read_an_array(made: MadeSet, tmp_path, monkeypatch) -> None:
    """Expected: the first sample's depth, as it is in the store."""
    out = tmp_path / "set"
    recipe = made.recipe.model_copy(update={"format": "hdf5"})
    packed = pack(recipe, made.bases, made.draws, made.work, out)
    text = card_text(out, packed)
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(out)
    names: dict = {}
    exec(block, names)
    case = next(draw.case for draw in made.draws if draw.case is not None)
    stored = Store(made.work).path_of(case.digest) / SAMPLE_FOLDER / "depth_mm.npy"
    assert np.array_equal(names["array"], np.load(stored))
    assert "Above: `frames`, the first image. Below: `depth_mm`, negative" in text
    assert "Codes of `decoded_reason`, fringes: 0 VALID, 1 DARK" in text
    assert "photometric stereo: 0" not in text
    for kind, line in (("webdataset", 'sample["depth_mm.npy"]'), ("parquet", '[0]["depth_mm"]')):
        of = made.recipe.model_copy(update={"format": kind})
        other = pack(of, made.bases, made.draws, made.work, tmp_path / kind)
        assert line in card_text(tmp_path / kind, other)


def test_only_logarithmic_axes_have_a_logarithmic_histogram(made: MadeSet, tmp_path) -> None:
    """A uniform seed covers decades, too. Labels of decades are numbers, not formulas."""
    import matplotlib.axes

    packed = pack(made.recipe, made.bases, made.draws, made.work, tmp_path / "set")
    assert logarithmic(packed) == frozenset()
    drawn: list = []
    hist = matplotlib.axes.Axes.hist

    def watched(axes, *args, **keys):
        drawn.append(axes)
        return hist(axes, *args, **keys)

    values = np.geomspace(1.0, 1e6, 40).tolist()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.axes.Axes, "hist", watched)
        draw_distributions(tmp_path / "a.png", {"seed": values, "rms": values}, {"rms"})
    assert [axes.get_xscale() for axes in drawn] == ["linear", "log"]
    labels = [tick.get_text() for tick in drawn[1].get_xticklabels()]
    assert not any("mathdefault" in label for label in labels)

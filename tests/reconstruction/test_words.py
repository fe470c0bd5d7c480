"""Encodings of code words: bits against definitions; a kind from a plug-in file."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.registry import PLUGINS_VARIABLE, load_plugin
from reconstruction.rig.sensor import SensorNoise
from reconstruction.words import WORDS, WordEncoding
from tests.reconstruction.conftest import frames_at, ramps

PLUGIN = Path(__file__).parents[2] / "docs/extend/scattered_word.py"
QUIET = SensorNoise(0.0, 0.0, 0.0, 255.0)


@pytest.fixture
def scattered(monkeypatch):
    """The encoding of scattered_word.py, until the test ends."""
    monkeypatch.setenv(PLUGINS_VARIABLE, os.environ.get(PLUGINS_VARIABLE, ""))
    WORDS.names()
    before = set(sys.modules)
    load_plugin(PLUGIN)
    yield "scattered"
    del WORDS._kinds["scattered"]
    for name in set(sys.modules) - before:
        if name.startswith("fringe_twin_plugin_"):
            del sys.modules[name]


def gray_by_mirroring(bits):
    """Return the reflected code from its definition: the list, then its mirror image with a 1."""
    rows = [[]]
    for _ in range(bits):
        rows = [[0, *row] for row in rows] + [[1, *row] for row in rows[::-1]]
    return np.array(rows)


@pytest.mark.parametrize(("word", "fine"), [("reflected", None), ("xor_02", -1), ("xor_04", -2)])
def test_gray_words_are_those_of_the_definition(word, fine):
    """XOR codes: every coarser bit of the mirrored list combined with the last, or last but one."""
    expected = gray_by_mirroring(6)
    if fine is not None:
        expected[:, :fine] ^= expected[:, fine:][:, :1]
    shown = WORDS[word].shown(np.arange(64), 6)
    assert [f"{number:06b}" for number in shown] == ["".join(map(str, row)) for row in expected]


@pytest.mark.parametrize("bits", [1, 2, 3, 10])
@pytest.mark.parametrize("word", WORDS.names())
def test_words_are_read_as_they_were_shown(word, bits):
    """Also by the functions of a kind that does not use the table."""
    kind, words = WORDS[word], np.arange(2**bits)
    places = np.arange(bits)[::-1, None]
    shown = ((kind.shown(words, bits) >> places) & 1).astype(bool)
    np.testing.assert_array_equal(kind.binary(shown), (words >> places) & 1)
    np.testing.assert_array_equal(WordEncoding.binary(kind, shown), (words >> places) & 1)


@pytest.mark.parametrize("steps", [0, 4])
def test_words_of_a_plug_in_decode_exactly(scattered, steps):
    """Expected: the pixel's own word without fringes; with them the place to 1e-3 px."""
    patterns = PatternSet(
        320, 180, period_px=16.0 if steps else 4.0, steps=steps, code="gray", word=scattered
    )
    column_px, row_px = ramps(60, 300, patterns)
    stack = frames_at(patterns, column_px, row_px).astype(np.float32)
    decoded = decode(stack, patterns, QUIET, DecodeOptions(filter_taps=0))
    assert decoded.valid.mean() > 0.95
    for axis, true_px in ((decoded.column, column_px), (decoded.row, row_px)):
        error_px = np.abs(axis.coordinate_px - true_px)[decoded.valid]
        assert error_px.max() < (1e-3 if steps else 2.51)


def test_a_plug_in_word_is_known_to_experiments_and_its_keys(scattered):
    from twin.config.models import Patterns
    from twin.config.schema import validated

    table = {"period_px": 16.0, "steps": 4, "code": "gray", "word": scattered}
    assert validated(Patterns, table).word == scattered
    assert scattered in Patterns.model_json_schema()["properties"]["word"]["enum"]


def test_an_encoding_that_shows_two_words_alike_is_rejected():
    class Halved(WordEncoding):
        name = "halved"

        def shown(self, words, bits):
            return words >> 1

    with pytest.raises(InputError, match="'halved' shows two words of 3 bits alike"):
        Halved().words_of(3)

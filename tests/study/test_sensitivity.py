"""Sensitivities of functions with known effects."""

import numpy as np
import pytest

from twin.config.study import Study
from twin.study.cases import shares_of
from twin.study.sensitivity import (
    adjusted_shares,
    correlation_ratio,
    morris_effects,
    saltelli_effects,
)

AXES = ("a", "b", "c")


def shares(method, count):
    axis = tuple({"path": name, "low": 0.0, "high": 1.0} for name in AXES)
    sampling = {"method": method, "count": count, "seed": 1}
    return shares_of(Study(name="t", base="x", axis=axis, sampling=sampling))


def test_ishigami():
    """Ishigami and Homma (1990), a = 7, b = 0.1: S = 0.314, 0.442, 0; totals 0.558, 0.442, 0.244.

    A large added constant must not change the effects.
    """
    x = np.pi * (2.0 * shares("saltelli", 4096) - 1.0)
    values = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    for constant in (0.0, 1000.0):
        result = saltelli_effects((values + constant).reshape(5, -1), AXES)
        assert [item.value for item in result] == pytest.approx([0.314, 0.442, 0.0], abs=0.02)
        assert [item.total for item in result] == pytest.approx([0.558, 0.442, 0.244], abs=0.02)
        for item, true in zip(result, (0.314, 0.442, 0.0), strict=True):
            assert item.low - 0.01 <= true <= item.high + 0.01
            assert item.high - item.low < 0.15


def test_failed_points_cost_their_rows_only():
    values = (shares("saltelli", 256) @ [1.0, 2.0, 0.0]).reshape(5, -1)
    values[3, 7] = np.nan
    result = saltelli_effects(values, AXES)
    assert [item.value for item in result] == pytest.approx([0.2, 0.8, 0.0], abs=0.06)


def test_morris_on_a_plane_and_an_interaction():
    """A plane: mu* is the slope, sigma 0. A product adds spread to both of its axes."""
    walks = shares("morris", 12).reshape(12, 4, 3)
    plane = morris_effects(walks @ [2.0, -3.0, 0.0], walks, AXES)
    assert [item.value for item in plane] == pytest.approx([2.0, 3.0, 0.0])
    assert [item.total for item in plane] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    product = morris_effects(walks[..., 0] * walks[..., 1], walks, AXES)
    assert min(product[0].total, product[1].total) > 0.1
    assert product[2].value == 0.0


def test_shares_of_a_grid():
    """y = 3 i + j over a 4 x 4 grid: variances 9 to 1."""
    i, j = np.divmod(np.arange(16), 4)
    assert correlation_ratio(3.0 * i + j, list(map(str, i))) == pytest.approx(0.9)
    assert correlation_ratio(3.0 * i + j, list(map(str, j))) == pytest.approx(0.1)


def test_adjusted_shares_of_noise_are_small():
    """Setup: 24 random values in six groups, in 200 draws; the plain share is 5 / 23 on average."""
    rng, labels = np.random.default_rng(0), [str(n % 6) for n in range(24)]
    draws = [rng.normal(size=24) for _ in range(200)]
    plain = np.mean([correlation_ratio(values, labels) for values in draws])
    assert plain == pytest.approx(5 / 23, abs=0.02)
    adjusted = [adjusted_shares(values, {"a": labels})[0].value for values in draws]
    assert np.mean(adjusted) < 0.1
    assert adjusted_shares(np.arange(8.0), {"a": list(map(str, range(8)))}) == []

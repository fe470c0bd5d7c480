"""Johnson's distribution against Gauss-Hermite quadrature of its own definition."""

from math import exp

import numpy as np
import pytest

from twin.mechanics.texture import Johnson, johnson_of

MOMENTS = [(0.0, 0.0), (0.0, 3.0), (0.0, 40.0), (0.5, 1.0), (-1.0, 5.0), (2.5, 16.0), (1e-6, 0.01)]


@pytest.mark.parametrize(("skewness", "excess_kurtosis"), MOMENTS)
def test_it_has_the_moments_asked_for(skewness: float, excess_kurtosis: float) -> None:
    nodes, weights = np.polynomial.hermite_e.hermegauss(200)
    distribution = johnson_of(skewness, excess_kurtosis).of_normal(nodes)
    moments = [weights / weights.sum() @ distribution**power for power in (1, 2, 3, 4)]
    expected = [0.0, 1.0, skewness, 3.0 + excess_kurtosis]
    np.testing.assert_allclose(moments, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("distribution", [Johnson(), Johnson(0.6), Johnson(0.7, -0.4)])
@pytest.mark.parametrize("of_normals", [-0.5, 0.0, 0.3, 0.9, 1.0])
def test_correlation_of_pairs(distribution: Johnson, of_normals: float) -> None:
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    first, independent = np.meshgrid(nodes, nodes)
    second = of_normals * first + np.sqrt(1 - of_normals**2) * independent
    product = distribution.of_normal(first) * distribution.of_normal(second)
    expected = float((np.outer(weights, weights) * product).sum() / weights.sum() ** 2)
    assert distribution.correlation(of_normals) == pytest.approx(expected, abs=1e-8)


def test_correlation_is_inverted() -> None:
    distribution = johnson_of(1.0, 8.0)
    assert distribution.correlation(distribution.correlation_of_normals(exp(-1))) == pytest.approx(
        exp(-1)
    )


def test_heights_grow_with_the_normal_number() -> None:
    assert (np.diff(johnson_of(-2.0, 12.0).of_normal(np.linspace(-6, 6, 500))) > 0).all()

"""A patch responds exactly as the whole grid does, and its scaling is a symmetric inverse."""

import numpy as np
import pytest

from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.patch import Span

SLAB = FreeSlab(48, 60, 15.0, 12.0, 2.0, 0.49)
LAYER = BondedLayer(48, 60, 15.0, 12.0, 2.0, 0.4)
PATCHES = [
    (Span(5, 11), Span(20, 17)),
    (Span(0, 48), Span(0, 60)),
    (Span(30, 18), Span(41, 19)),
    (Span(7, 1), Span(9, 1)),
]


@pytest.mark.parametrize("layer", [SLAB, LAYER])
@pytest.mark.parametrize(("rows", "cols"), PATCHES)
def test_a_patch_deflects_as_the_whole_grid(
    layer: FreeSlab | BondedLayer, rows: Span, cols: Span
) -> None:
    patch = layer.patch(rows, cols)
    pressure = np.zeros((48, 60))
    pressure[patch.cells] = np.random.default_rng(0).normal(size=(rows.count, cols.count))
    whole = layer.deflect(pressure)[patch.cells]
    result = patch.deflect(pressure[patch.cells])
    np.testing.assert_allclose(result, whole, atol=1e-12 * np.abs(layer.deflect(pressure)).max())


@pytest.mark.parametrize("layer", [SLAB, LAYER])
def test_scaling_is_symmetric_positive_and_near_the_inverse(
    layer: FreeSlab | BondedLayer,
) -> None:
    patch = layer.patch(Span(8, 30), Span(10, 40))
    first, second = np.random.default_rng(1).normal(size=(2, 30, 40))
    forward = np.vdot(first, patch.apply(second))
    assert forward == pytest.approx(np.vdot(second, patch.apply(first)), rel=1e-10)
    assert np.vdot(first, patch.apply(first)) > 0
    single = np.zeros((30, 40))
    single[12, 17] = 1.0
    assert patch.apply(single)[12, 17] == pytest.approx(patch.cell, rel=1e-12)
    # Away from the patch's edge the two are inverse: a smooth bump is recovered.
    y, x = np.mgrid[-1:1:30j, -1:1:40j]
    bump = np.exp(-12 * (x**2 + y**2))
    back = patch.apply(patch.deflect(bump))
    assert np.abs(back - bump)[10:20, 13:27].max() < 0.2


def test_a_coarsened_layer_keeps_its_size() -> None:
    coarse = SLAB.coarsened(4)
    assert (coarse.rows, coarse.cols) == (12, 15)
    assert (coarse.length_x_mm, coarse.thickness_mm) == (15.0, 2.0)

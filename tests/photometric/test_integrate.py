import sys

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.photometric.integrate import (
    corrected,
    edge_weights,
    integrate,
    sdk_faithful,
    solve_poisson,
    solve_weighted,
    sum_of_steps,
)

# The package's name `integrate` is the function.
MODULE = sys.modules[integrate.__module__]
PITCH_MM, SHAPE = 0.0634, (240, 320)
# Recovered / true peak-to-valley of Gaussian pits, measured on the vendor's published programs.
SIGMAS_MM = (0.25, 0.51, 0.76, 1.01, 1.27, 1.90, 2.54, 3.80)
MEASURED = {
    "2025": (0.90, 0.82, 0.75, 0.69, 0.64, 0.54, 0.48, 0.41),
    "2024": (1.78, 1.63, 1.50, 1.38, 1.28, 1.09, 0.95, 0.78),
}


def pit(sigma_mm, shape=SHAPE, pitch_mm=PITCH_MM):
    """Return height and slopes of a Gaussian centred on a pixel."""
    row, col = np.indices(shape, dtype=float)
    y, x = (row - shape[0] // 2) * pitch_mm, (col - shape[1] // 2) * pitch_mm
    height = np.exp(-(x**2 + y**2) / (2.0 * sigma_mm**2))
    return height, np.stack([-y, -x]) / sigma_mm**2 * height


def scale(result, true):
    return np.ptp(result) / np.ptp(true)


@pytest.mark.parametrize("sigma_mm", SIGMAS_MM)
def test_corrected_peak(sigma_mm):
    """The smallest pit has a sigma of 4 px: the trapezoid rule loses (px / sigma)^2 / 8 there."""
    height, slopes = pit(sigma_mm)
    result = corrected(slopes, PITCH_MM)
    assert scale(result, height) == pytest.approx(1.0, abs=0.01)
    assert abs(result.mean()) < 1e-12
    np.testing.assert_allclose(result - result.min(), height - height.min(), atol=0.009)


@pytest.mark.parametrize("form", ["2025", "2024"])
@pytest.mark.parametrize("number", range(len(SIGMAS_MM)))
def test_vendor_forms_follow_the_measured_table(form, number):
    height, slopes = pit(SIGMAS_MM[number])
    result = scale(sdk_faithful(slopes, PITCH_MM, form), height)
    assert result == pytest.approx(MEASURED[form][number], rel=0.03)


def test_vendor_forms_flatten_a_tilt():
    """Measured: a constant tilt is returned with 0.18 of its slope, correlation 0.97."""
    col_mm = np.indices(SHAPE)[1] * PITCH_MM
    slopes = np.stack([np.zeros(SHAPE), np.full(SHAPE, 0.1)])
    for form in ("2024", "2025"):
        result = sdk_faithful(slopes, PITCH_MM, form)
        assert np.polyfit(col_mm.ravel(), result.ravel(), 1)[0] == pytest.approx(0.018, rel=0.03)
        assert np.corrcoef(col_mm.ravel(), result.ravel())[0, 1] == pytest.approx(0.97, abs=0.005)


def test_corrected_keeps_a_tilt_exactly():
    row, col = np.indices(SHAPE) * PITCH_MM
    slopes = np.stack([np.full(SHAPE, -0.2), np.full(SHAPE, 0.1)])
    expected = -0.2 * row + 0.1 * col
    result = corrected(slopes, PITCH_MM)
    np.testing.assert_allclose(result, expected - expected.mean(), atol=1e-11)


def test_held_border_pulls_wide_shapes_down():
    """Measured on a published sine-transform solver: 1 % up to 2.5 mm, 0.94 at 3.8 mm."""
    for sigma_mm in SIGMAS_MM[:-1]:
        assert corrected(pit(sigma_mm)[1], PITCH_MM, "dirichlet").max() == pytest.approx(1.0, 0.01)
    result = corrected(pit(3.8)[1], PITCH_MM, "dirichlet")
    assert result.max() == pytest.approx(0.94, abs=0.015)
    assert not result[[0, -1]].any()
    assert not result[:, [0, -1]].any()


def test_second_order():
    """Half the pitch, a quarter of the error: the trapezoid rule is of order 2."""
    errors = []
    for factor in (1, 2):
        height, slopes = pit(0.5, (60 * factor + 1, 80 * factor + 1), 0.12 / factor)
        result = corrected(slopes, 0.12 / factor)
        errors.append(np.abs(result - result[0, 0] - height + height[0, 0]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet"])
def test_fast_solver_inverts_the_laplacian(boundary):
    height = np.random.default_rng(1).normal(size=(23, 18))
    if boundary == "neumann":
        height -= height.mean()
    else:
        height[[0, -1]] = height[:, [0, -1]] = 0.0
    right = sum_of_steps(np.diff(height, axis=0), np.diff(height, axis=1))
    np.testing.assert_allclose(solve_poisson(right, boundary), height, atol=1e-12)


def dense_solution(row_steps, col_steps, weights, unknown):
    """Least squares over all edges by a dense matrix; pixels not `unknown` are at 0."""
    rows, cols = weights.shape
    number = np.arange(rows * cols).reshape(rows, cols)
    edges = edge_weights(weights)
    first = np.concatenate([number[:-1].ravel(), number[:, :-1].ravel()])
    second = np.concatenate([number[1:].ravel(), number[:, 1:].ravel()])
    root = np.sqrt(np.concatenate([edges.to_next_row.ravel(), edges.to_next_col.ravel()]))
    matrix = np.zeros((len(first), rows * cols))
    matrix[np.arange(len(first)), first] = -root
    matrix[np.arange(len(first)), second] = root
    steps = root * np.concatenate([row_steps.ravel(), col_steps.ravel()])
    solution = np.zeros(rows * cols)
    used = unknown.ravel()
    solution[used] = np.linalg.lstsq(matrix[:, used], steps)[0]
    return solution.reshape(rows, cols)


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet"])
def test_weighted_solver_equals_dense_least_squares(boundary):
    """Steps that fit no surface, weights over a decade, holes, compared with normal equations."""
    random = np.random.default_rng(2)
    row_steps, col_steps = random.normal(size=(11, 14)), random.normal(size=(12, 13))
    weights = random.uniform(0.1, 1.0, (12, 14))
    weights[3:6, 4:8] = weights[9, 2:5] = 0.0
    unknown = weights > 0.0
    if boundary == "dirichlet":
        unknown[[0, -1]] = unknown[:, [0, -1]] = False
    expected = dense_solution(row_steps, col_steps, weights, unknown)
    result = solve_weighted(row_steps, col_steps, weights, boundary)
    if boundary == "neumann":
        expected[unknown] -= expected[unknown].mean()
    np.testing.assert_allclose(result, expected, atol=1e-3 * np.ptp(expected))


def test_invalid_pixels_do_not_matter():
    """Invalid values of weight 0 change no other pixel; the pit around them is right."""
    height, slopes = pit(0.8, (96, 128))
    row, col = np.indices((96, 128))
    hole = (row // 8 % 3 == 1) & (col // 8 % 3 == 1)
    broken = np.where(hole, 50.0, slopes)
    result = corrected(broken, PITCH_MM, weights=~hole)
    np.testing.assert_allclose(
        result, corrected(slopes, PITCH_MM, weights=~hole), atol=1e-12 * 50.0
    )
    error = (result - height)[~hole]
    assert np.ptp(error) < 0.005
    assert not result[hole].any()


def test_iterations_do_not_grow_with_the_grid(monkeypatch):
    """The same holes on a grid of nine times the pixels: at most two iterations more."""
    counts = []
    for factor in (1, 3):
        shape = (48 * factor, 64 * factor)
        _, slopes = pit(0.5, shape, PITCH_MM / factor)
        row, col = np.indices(shape) // (4 * factor)
        calls = []
        monkeypatch.setattr(MODULE, "solve_poisson", counting(calls))
        corrected(slopes, PITCH_MM / factor, weights=(row % 3 != 1) | (col % 3 != 1))
        counts.append(len(calls))
    assert counts[0] < 20
    assert counts[1] <= counts[0] + 2


def counting(calls):
    def solve(*arguments):
        calls.append(arguments)
        return solve_poisson(*arguments)

    return solve


def test_equal_weights_are_no_weights():
    _, slopes = pit(0.8, (48, 64))
    result = corrected(slopes, PITCH_MM, weights=np.full((48, 64), 0.3))
    np.testing.assert_allclose(result, corrected(slopes, PITCH_MM), atol=1e-12)


def test_named_schemes():
    _, slopes = pit(0.8, (48, 64))
    for name, form in (("sdk_2024", "2024"), ("sdk_2025", "2025")):
        expected = sdk_faithful(slopes, PITCH_MM, form)
        np.testing.assert_array_equal(integrate(slopes, PITCH_MM, name), expected)
    np.testing.assert_array_equal(integrate(slopes, PITCH_MM), corrected(slopes, PITCH_MM))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slopes": np.zeros((3, 8, 8))}, r"give \(2, row, col\)"),
        ({"slopes": np.full((2, 8, 8), np.nan)}, "NaN"),
        ({"pitch_mm": 0.0}, "pitch_mm"),
        ({"boundary": "open"}, "neumann, dirichlet"),
        ({"weights": np.ones((8, 7))}, r"\(8, 8\)"),
        ({"weights": -np.ones((8, 8))}, "weights"),
        ({"integration": "sdk"}, "sdk_2024"),
    ],
)
def test_bad_input_is_named(change, message):
    with pytest.raises(InputError, match=message):
        integrate(**({"slopes": np.zeros((2, 8, 8)), "pitch_mm": 0.1} | change))

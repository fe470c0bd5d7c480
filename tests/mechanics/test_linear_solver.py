"""Solvers of sparse systems: residuals, indefinite matrices, the same bytes for any threads."""

import numpy as np
import pytest
from scipy import sparse
from threadpoolctl import threadpool_limits

from twin.mechanics.sheet.dissection import dissected
from twin.mechanics.sheet.linear_solver import (
    ACCURACY,
    Banded,
    LinearSolver,
    NestedDissection,
    Pardiso,
    has_pardiso,
    linear_solver,
    threads_for,
)

SPARSE = [NestedDissection, *([Pardiso] if has_pardiso() else [])]
SOLVERS = [Banded, *SPARSE]


def upper_triangle(shift: float) -> sparse.csr_matrix:
    """A membrane's 15 x 15 Laplacian, less `shift` on its diagonal; lowest eigenvalue 0.0768."""
    line = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (15, 15))
    both = sparse.kronsum(line, line) - shift * sparse.identity(225)
    return sparse.csr_matrix(sparse.triu(both))


def plate(points: int, components: int) -> sparse.csr_matrix:
    """Return the upper triangle of a plate's stiffness: points couple with those two apart."""
    line = sparse.diags([-1.0, 2.001, -1.0], [-1, 0, 1], (points, points))
    near = sparse.csr_matrix(sparse.kronsum(line, line))
    mixed = sparse.csr_matrix(np.eye(components) + 0.3)
    matrix = sparse.csr_matrix(sparse.triu(sparse.kron(near @ near, mixed)))
    matrix.sort_indices()
    return matrix


def whole(upper: sparse.csr_matrix) -> sparse.csr_matrix:
    return upper + sparse.triu(upper, 1).T


@pytest.mark.parametrize("kind", SOLVERS)
def test_linear_solvers_solve_and_know_what_is_indefinite(kind: type[LinearSolver]) -> None:
    matrix = upper_triangle(0.0)
    solver = kind(matrix.indptr, matrix.indices)
    right = np.random.default_rng(5).normal(size=225)
    for shift in (0.0, 0.07):
        matrix = upper_triangle(shift)
        assert solver.factorise(matrix.data.copy())
        np.testing.assert_allclose(whole(matrix) @ solver.solve(right), right, atol=1e-10)
    assert not solver.factorise(upper_triangle(0.08).data.copy())
    assert solver.factorise(upper_triangle(0.0).data.copy())


@pytest.mark.parametrize("kind", SOLVERS)
def test_factors_of_a_matrix_nearly_solve_for_another(kind: type[LinearSolver]) -> None:
    """The residual is that in the metric of the factors, which here is computed by itself."""
    first, second = upper_triangle(0.0), upper_triangle(0.07)
    solver = kind(first.indptr, first.indices)
    assert solver.factorise(first.data.copy())
    right = np.random.default_rng(7).normal(size=225)
    near = solver.approximate(second.data.copy(), right)
    assert near.is_accurate
    residual = right - whole(second) @ near.solution
    inverse = np.linalg.inv(whole(first).toarray())
    norm = np.sqrt((residual @ inverse @ residual) / (right @ inverse @ right))
    assert norm == pytest.approx(near.residual, abs=1e-6)
    if kind is Banded:
        assert near.residual == 0.0
    else:
        assert near.residual > 1e-6
    assert solver.approximate(upper_triangle(3.0).data.copy(), right).residual == np.inf


@pytest.mark.parametrize("kind", SPARSE)
def test_factors_of_a_far_matrix_are_not_accurate(kind: type[LinearSolver]) -> None:
    first = plate(12, 1)
    solver = kind(first.indptr, first.indices)
    assert solver.factorise(first.data.copy())
    far = first.copy()
    far.data[first.indptr[:-1]] += np.geomspace(1e-3, 1e4, 144)
    near = solver.approximate(far.data.copy(), np.random.default_rng(8).normal(size=144))
    assert 0.05 < near.residual < np.inf
    assert not near.is_accurate


@pytest.mark.parametrize("kind", SPARSE)
def test_solutions_have_the_same_bytes_with_any_number_of_threads(
    kind: type[LinearSolver], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Large enough that two threads share the factors, which are in single precision."""
    matrix = plate(150, 1)
    right = np.random.default_rng(6).normal(size=matrix.shape[0])
    result = set()
    for count in (1, 2, 3):
        monkeypatch.setattr("twin.mechanics.sheet.linear_solver.threads", lambda n=count: n)
        with threadpool_limits(count, user_api="blas"):
            solver = kind(matrix.indptr, matrix.indices)
            assert solver.factorise(matrix.data.copy())
            solution = solver.solve(right)
        result.add(solution.tobytes())
        residual = np.linalg.norm(whole(matrix) @ solution - right) / np.linalg.norm(right)
        assert residual < 2 * ACCURACY  # of factors in single precision alone: 2e-3
        step = solver.solve(right, 1e-4)
        assert np.linalg.norm(whole(matrix) @ step - right) < 2e-4 * np.linalg.norm(right)
    assert len(result) == 1
    assert threads_for(matrix.shape[0]) == threads_for(10**6) > threads_for(10**4) == 1


def test_dissection_of_a_plate_needs_60_percent_of_the_elements_of_the_band() -> None:
    """Each unknown is in one front; a front's border is eliminated later."""
    matrix = plate(60, 3)
    elimination = dissected(matrix.indptr, matrix.indices)
    size = matrix.shape[0]
    np.testing.assert_array_equal(np.sort(elimination.rank), np.arange(size))
    end, elements = 0, 0
    for number, front in enumerate(elimination.fronts):
        assert front.first == end < front.end
        assert (front.border >= front.end).all()
        assert all(child < number for child in front.children)
        end = front.end
        own = front.end - front.first
        elements += own * (own + 1) // 2 + own * front.border.size
    assert end == size
    assert elements < 0.6 * size * 3 * 122  # the band has 122 points of three components


@pytest.mark.parametrize("density", [0.002, 0.05])
def test_patterns_without_a_grid_are_solved_too(density: float) -> None:
    """Not every unknown is coupled, and no two rows are equal."""
    rng = np.random.default_rng(9)
    loose = sparse.random(400, 400, density, random_state=rng)
    matrix = sparse.csr_matrix(sparse.triu(loose @ loose.T + 0.1 * sparse.identity(400)))
    matrix.sort_indices()
    solver = NestedDissection(matrix.indptr, matrix.indices)
    right = rng.normal(size=400)
    assert solver.factorise(matrix.data.copy())
    np.testing.assert_allclose(whole(matrix) @ solver.solve(right), right, atol=1e-9)


def test_lines_of_very_different_length_are_halved() -> None:
    """60 points on one line, and 100 lines of one point each, which nothing is coupled with."""
    coupled = np.concatenate((np.full(59, -1.0), np.zeros(100)))
    upper = sparse.csr_matrix(sparse.diags([np.full(160, 4.0), coupled], [0, 1]))
    upper.eliminate_zeros()
    elimination = dissected(upper.indptr, upper.indices)
    assert max(front.end - front.first for front in elimination.fronts) < 24
    solver = NestedDissection(upper.indptr, upper.indices)
    right = np.random.default_rng(2).normal(size=160)
    assert solver.factorise(upper.data.copy())
    np.testing.assert_allclose(whole(upper) @ solver.solve(right), right, atol=1e-12)


def test_small_systems_are_banded_and_large_ones_are_not() -> None:
    small, large = plate(10, 3), plate(60, 3)
    assert isinstance(linear_solver(small.indptr, small.indices), Banded)
    assert isinstance(linear_solver(large.indptr, large.indices), tuple(SPARSE))

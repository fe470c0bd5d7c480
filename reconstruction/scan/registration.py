"""Estimate the poses of all patches of a scan together, from stage positions and overlaps.

The pose of patch k is T_k = N_k E(xi_k): its nominal pose N_k on the stage, and a small motion xi_k
= (translation mm, rotation vector rad) in the frame of the sensor. The stage states

    xi_k = S u_k + t_k D w,    u_k, w standard normal,

with the standard deviations S of one position and the drift D over the whole path (t from 0 to 1).
In the overlap of two patches the elements of one whose windows do not overlap are compared with the
surface of the other: their distance along the normal has the variance that follows from both
elements. One Gauss-Newton iteration over all poses minimises the sum of squares of stage and
distances (Bayes' estimate with the stage as prior); the elements are assigned again after each
step. Distances above 5 standard deviations are left out, and those above 2 have less weight
(Huber).

Three properties of the estimate:

- Scale. The distances are divided by the Birge ratio b, 1.4826 times their median over sigma, times
  sqrt(n / (n - p)) for n distances that determine p = trace((I + H)^-1 H) unknowns. It contains
  errors of neighbouring pixels that the decoder's filter correlates, which make the mean of a
  window worse than for independent errors. Errors that are alike over a whole patch (a wrong
  calibration) are not contained.
- Noise of normals. The normals of a plane have noise, so that the information H = sum w J J^T has a
  part N along the plane: noise of one patch is matched with noise of the other, and the plane seems
  to fix its own sliding. The expectation of N follows from the covariance of the slopes (errors in
  variables; Fuller, Measurement Error Models, 1987, section 2.2). The error of the estimate is
  v' - v = -(I + H)^-1 ((I + N) v + noise), which has the covariance
  (I + H)^-1 ((I + N)^2 + H) (I + H)^-1, at a perfect plane that of the stage.
- Degenerate directions. A direction in which the overlaps of a patch are weaker than the stage
  keeps the standard deviation of the stage and is reported by name: planes and cylinders slide.

SciPy's k-d tree and dense normal equations of 6 unknowns per patch are used, not a library such as
small_gicp: those register pairs without sigma, prior or covariance, which all are needed here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError, counted
from reconstruction.scan.elements import SurfaceElements, values_at

AXES = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")
MOST_PATCHES = 300
GATE, HUBER, MEDIAN_TO_SIGMA = 5.0, 2.0, 1.4826
LEAST_ELEMENTS = 12
"""Fewest compared elements of an overlap: twice the number of unknowns of a pose."""
_ITERATIONS = 40
_FULL_STEPS = 5
# Copies of one patch have no distance at all: the stated noise counts by a tenth at least, so that
# the normal equations stay solvable.
_LEAST_BIRGE = 0.1
# In standard deviations. A step changes which elements are compared, and they change the poses:
# later steps are shortened, as in stochastic approximation (Robbins and Monro, 1951).
_STILL = 0.05


@dataclass(frozen=True)
class StagePrior:
    """Standard deviations of the stage; a value of 0 keeps that coordinate at its nominal value.

    Parameters
    ----------
    sigma_mm : of x, y and z of one position
    sigma_rad : of the rotations about x, y and z of one position
    drift_mm : of the drift in x, y and z from the first to the last position, uniform in between
    """

    sigma_mm: tuple[float, float, float]
    sigma_rad: tuple[float, float, float]
    drift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def factor(self, patches: int) -> FloatArray:
        """Return X (6 patches, 6 patches + 3) with xi = X v for standard normal v = (u, w)."""
        sigma = np.array([*self.sigma_mm, *self.sigma_rad])
        path = np.linspace(0.0, 1.0, patches) if patches > 1 else np.zeros(1)
        drift = np.concatenate([np.diag(self.drift_mm), np.zeros((3, 3))])
        return np.hstack([np.diag(np.tile(sigma, patches)), np.kron(path[:, np.newaxis], drift)])


@dataclass(frozen=True)
class Overlap:
    """Comparison of two patches where both have a surface.

    Parameters
    ----------
    first, second : numbers of the patches
    elements : number of compared elements
    median_mm, rms_mm : median and root mean square of their distances, those left out excepted
    left_out : number of distances above 5 standard deviations
    """

    first: int
    second: int
    elements: int
    median_mm: float
    rms_mm: float
    left_out: int


@dataclass(frozen=True)
class FreeDirection:
    """Motion of one patch that its overlaps determine less well than the stage.

    Parameters
    ----------
    patch : number of the patch
    axis : largest component, one of `AXES`
    share : the six components of the motion in units of the stage's sigma, a unit vector
    """

    patch: int
    axis: str
    share: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Registration:
    """Poses of all patches in the frame of the part, with their joint covariance.

    Parameters
    ----------
    T_part_from_sensor : (patch, 4, 4), translation in mm
    motion : (patch, 6) xi, from the nominal pose: mm and rad, frame of the sensor
    covariance : (6 patches, 6 patches) covariance of all xi
    drift_mm, drift_sigma_mm : (3,) drift over the whole path and its standard deviation
    birge_ratio : b, see the module
    overlaps : comparison of each pair of patches that overlap
    free : directions that the stage determines
    """

    T_part_from_sensor: FloatArray
    motion: FloatArray
    covariance: FloatArray
    drift_mm: FloatArray
    drift_sigma_mm: FloatArray
    birge_ratio: float
    overlaps: tuple[Overlap, ...]
    free: tuple[FreeDirection, ...]

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of `motion`, (patch, 6), mm and rad."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class _Distances:
    """Distances of the elements of patch i from the surface of patch j.

    Parameters
    ----------
    distance_mm, sigma_mm : (n,) along the normal
    by_both : (n, 12) derivatives of the distance by xi_i and xi_j
    by_slopes : (n, 12, 2) derivatives of `by_both` by the slopes of the surface of j
    slope_covariance : (n, 2, 2) covariance of these slopes
    """

    i: int
    j: int
    distance_mm: FloatArray
    sigma_mm: FloatArray
    by_both: FloatArray
    by_slopes: FloatArray
    slope_covariance: FloatArray


def register(
    patches: Sequence[SurfaceElements], nominal: FloatArray, stage: StagePrior
) -> Registration:
    """Estimate the poses of patches.

    Parameters
    ----------
    patches : surface elements of each patch, in the frame of the sensor
    nominal : (patch, 4, 4) nominal poses T_part_from_sensor, mm
    stage : standard deviations of the nominal poses

    Raises
    ------
    InputError : there are fewer than two patches or more than 300, no two of them overlap, or the
        poses do not converge
    """
    count = len(patches)
    if not 2 <= count <= MOST_PATCHES:
        raise InputError(
            f"scan: found {counted(count, 'patch', 'patches')}, allowed 2 to {MOST_PATCHES}"
        )
    trees = [cKDTree(patch.centres_mm) for patch in patches]
    X = stage.factor(count)
    v, determined = np.zeros(X.shape[1]), 0.0
    for number in range(_ITERATIONS):
        motion = (X @ v).reshape(count, 6)
        pairs = _all_distances(patches, trees, moved(nominal, motion))
        birge = _birge_ratio(pairs, determined)
        H, noise, g = _normal_equations(pairs, count, birge)
        A = np.eye(len(v)) + X.T @ H @ X
        inverse = np.linalg.inv(A)
        determined = len(v) - float(np.trace(inverse))
        step = inverse @ (-v - X.T @ g)
        step /= max(1, number - _FULL_STEPS)
        v = v + step
        moving = float(np.sqrt(step @ A @ step / len(v)))
        if moving < _STILL:
            break
    else:
        raise InputError(
            f"scan: the poses still move by {moving:.2g} of their standard deviation after "
            f"{_ITERATIONS} iterations; state the true sigma of the stage, or use larger overlaps"
        )
    held = np.eye(len(v)) + X.T @ noise @ X
    of_v = inverse @ (held @ held + X.T @ H @ X) @ inverse
    motion, end = (X @ v).reshape(count, 6), np.diag(stage.drift_mm)
    return Registration(
        moved(nominal, motion),
        motion,
        X @ of_v @ X.T,
        end @ v[-3:],
        np.sqrt(np.diag(end @ of_v[-3:, -3:] @ end)),
        birge,
        tuple(_overlap(pair, birge) for pair in pairs),
        _free_directions(H - noise, stage, count),
    )


def moved(nominal: FloatArray, motion: FloatArray) -> FloatArray:
    """Return the poses N_k E(xi_k), (patch, 4, 4), of nominal poses and motions (patch, 6)."""
    E = np.tile(np.eye(4), (len(motion), 1, 1))
    E[:, :3, :3] = Rotation.from_rotvec(motion[:, 3:]).as_matrix()
    E[:, :3, 3] = motion[:, :3]
    return nominal @ E


def twist_of(normals: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Return the derivatives (n, 6) of n . p by translation (mm) and rotation vector (rad)."""
    return np.hstack([normals, np.cross(points_mm, normals)])


def _all_distances(
    patches: Sequence[SurfaceElements], trees: Sequence[cKDTree], T: FloatArray
) -> list[_Distances]:
    points = [patch.points_mm @ t[:3, :3].T + t[:3, 3] for patch, t in zip(patches, T, strict=True)]
    middles = np.array([some.mean(axis=0) for some in points])
    radii = [np.linalg.norm(p - m, axis=1).max() for p, m in zip(points, middles, strict=True)]
    near = [
        (i, j)
        for i, j in combinations(range(len(patches)), 2)
        if np.linalg.norm(middles[i] - middles[j]) <= radii[i] + radii[j]
    ]
    pairs = [_distances(patches, trees[j], T, i, j) for i, j in near]
    return [pair for pair in pairs if pair is not None]


def _distances(
    patches: Sequence[SurfaceElements], tree: cKDTree, T: FloatArray, i: int, j: int
) -> _Distances | None:
    """Return the distances of the elements of i from j; None if they do not overlap."""
    own, other = patches[i], patches[j]
    which = np.flatnonzero(own.is_apart)
    T_j_from_i = np.linalg.inv(T[j]) @ T[i]
    there = own.points_mm[which] @ T_j_from_i[:3, :3].T + T_j_from_i[:3, 3]
    away, nearest = tree.query(there[:, :2], distance_upper_bound=other.reach_mm)
    near = np.isfinite(away)
    if near.sum() < LEAST_ELEMENTS:
        return None
    which, there = which[near], there[near]
    here = own.points_mm[which]
    surface = values_at(other, nearest[near], there[:, :2])
    normals = np.column_stack([-surface.slopes, np.ones(len(there))])
    length = np.linalg.norm(normals, axis=1)
    normals /= length[:, np.newaxis]
    in_i = normals @ T_j_from_i[:3, :3]
    variance = surface.variance_mm2 / length**2 + own.variance_mm2[which] * in_i[:, 2] ** 2
    by_both = np.hstack([twist_of(in_i, here), -twist_of(normals, there)])
    steps = [-np.eye(3)[axis] / length[:, np.newaxis] for axis in (0, 1)]
    by_slopes = [
        np.hstack([twist_of(step @ T_j_from_i[:3, :3], here), -twist_of(step, there)])
        for step in steps
    ]
    return _Distances(
        i,
        j,
        (there[:, 2] - surface.z_mm) / length,
        np.sqrt(variance),
        by_both,
        np.stack(by_slopes, axis=-1),
        surface.slope_covariance,
    )


def _birge_ratio(pairs: Sequence[_Distances], determined: float) -> float:
    """Return b of distances that determine so many unknowns; each overlap has twice as many."""
    if not pairs:
        raise InputError(
            "scan: no two patches overlap; give positions with smaller steps, or check x_mm, y_mm "
            "and rotation_deg"
        )
    over_sigma = np.concatenate([np.abs(pair.distance_mm) / pair.sigma_mm for pair in pairs])
    left = float(np.sqrt(1.0 - determined / len(over_sigma)))
    return max(MEDIAN_TO_SIGMA * float(np.median(over_sigma)) / left, _LEAST_BIRGE)


def _normal_equations(
    pairs: Sequence[_Distances], count: int, birge: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sum w J^T J, the part of it that is noise of the normals, and sum w J^T r."""
    H, noise = np.zeros((6 * count, 6 * count)), np.zeros((6 * count, 6 * count))
    g = np.zeros(6 * count)
    for pair in pairs:
        at = np.concatenate([6 * pair.i + np.arange(6), 6 * pair.j + np.arange(6)])
        over = np.abs(pair.distance_mm) / (birge * pair.sigma_mm)
        weight = np.where(over <= GATE, np.minimum(1.0, HUBER / np.maximum(over, HUBER)), 0.0)
        weight /= (birge * pair.sigma_mm) ** 2
        spread = birge**2 * pair.slope_covariance
        H[np.ix_(at, at)] += np.einsum("n,nk,nl->kl", weight, pair.by_both, pair.by_both)
        noise[np.ix_(at, at)] += np.einsum(
            "n,nks,nst,nlt->kl", weight, pair.by_slopes, spread, pair.by_slopes, optimize=True
        )
        g[at] += (weight * pair.distance_mm) @ pair.by_both
    return H, noise, g


def _overlap(pair: _Distances, birge: float) -> Overlap:
    kept: BoolImage = np.abs(pair.distance_mm) <= GATE * birge * pair.sigma_mm
    used = pair.distance_mm[kept]
    median = float(np.median(used)) if len(used) else 0.0
    rms = float(np.sqrt(np.mean(used**2))) if len(used) else 0.0
    return Overlap(pair.i, pair.j, int(kept.sum()), median, rms, int((~kept).sum()))


def _free_directions(data: FloatArray, stage: StagePrior, count: int) -> tuple[FreeDirection, ...]:
    """Return the motions of each patch, its neighbours fixed, that the stage determines."""
    sigma = np.array([*stage.sigma_mm, *stage.sigma_rad])
    sigma = np.hypot(sigma, [*stage.drift_mm, 0.0, 0.0, 0.0])
    used = np.flatnonzero(sigma > 0.0)
    free = []
    for k in range(count):
        block = data[6 * k + used][:, 6 * k + used] * np.outer(sigma[used], sigma[used])
        values, vectors = np.linalg.eigh(block)
        for vector in vectors[:, values < 1.0].T:
            share = np.zeros(6)
            share[used] = vector
            axis = AXES[int(np.argmax(np.abs(share)))]
            free.append(FreeDirection(k, axis, tuple(map(float, share))))
    return tuple(free)

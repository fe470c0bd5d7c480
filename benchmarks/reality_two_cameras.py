"""Two cameras with one projector: merged points against those of each camera.

    ./run bench reality_two_cameras [--quick]

Matt gauges on the stage (`examples/gauges`): a disc, a rod and a ball of 4 mm. The projector is
above them, the cameras are 25 degrees to its left and right. Each stack is rendered, decoded and
triangulated with its own camera, then the points are merged.

- `merged_over_alone`: RMS error of merged points over that of the better camera alone, at the
  pixels of both; along the rays of each camera, without the 1 % largest errors of each set, which
  are at edges. Target: at most 1.
- `shadow_ratio`: area of the field without a point, merged over that of the better camera alone;
  cells of 0.1 mm. Target: at most 0.5.
- `merged_error_over_sigma`: 1.4826 times the median of |error| over standard deviation.

Last line: {"merged_over_alone", "shadow_ratio", "merged_error_over_sigma"}.
"""

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.cells import SquareCells
from reconstruction.merging import MEDIAN_TO_SIGMA, CameraView, Merged, merge
from reconstruction.rig.calibration import Calibration
from reconstruction.triangulation import PointMap
from twin.config import load_experiment, vary
from twin.pipeline import Measurement, measure

CAMERAS_DEG = 0.0, 180.0
"""Azimuths of the cameras."""
SETTINGS = {
    "projector.pose.polar_deg": {"value": 0.0, "range": [0, 45], "source": "assumed: from above"},
    "camera.pose.polar_deg": 25.0,
}
CELL_MM = 0.1
FIELD_MM = 11.0, 4.0
"""Half width and half height of the field that both cameras and the projector cover."""


def main() -> None:
    parser = quick_parser(__doc__ or "", "images of 484 x 183 px")
    print_figures(reality_two_cameras(parser.parse_args().quick))


def reality_two_cameras(quick: bool) -> dict[str, float]:
    """Render, decode and merge both cameras, and compare with each of them alone."""
    return compared(measured_by_both(4 if quick else 2))


def measured_by_both(binning: int) -> list[Measurement]:
    """Render and decode the stack of each camera."""
    return [_measured(azimuth, binning) for azimuth in CAMERAS_DEG]


def compared(measured: list[Measurement]) -> dict[str, float]:
    """Merge the points of both cameras, and compare them with those of each camera."""
    views = [CameraView(done.images.reconstruction.point_map, _rig(done)) for done in measured]
    merged = merge(views)
    print(merged.agreement)
    alone, together, normalised = _errors(measured, views, merged)
    clouds = [view.points.points_world_mm[view.points.valid] for view in views]
    empty = [_empty_share(cloud) for cloud in (*clouds, merged.points_mm)]
    print(f"RMS alone {alone} um, merged {together} um; without points {empty}")
    return {
        "merged_over_alone": max(together) / min(alone),
        "shadow_ratio": empty[-1] / min(empty[:-1]),
        "merged_error_over_sigma": normalised,
    }


def _measured(azimuth_deg: float, binning: int) -> Measurement:
    settings = SETTINGS | {"camera.pose.azimuth_deg": azimuth_deg, "camera.binning": binning}
    return measure(vary(load_experiment("examples/gauges"), settings | {"seed": int(azimuth_deg)}))


def _rig(done: Measurement) -> Calibration:
    return done.images.capture.calibration


def _errors(
    measured: list[Measurement], views: list[CameraView], merged: Merged
) -> tuple[list[float], list[float], float]:
    """Return the RMS error of each camera alone and merged, um, and error over sigma of merged."""
    alone, together, ratios = [], [], []
    for done, view, points, kept in zip(measured, views, merged.maps, merged.kept, strict=True):
        shared = points.sigma_z_mm < 0.99 * view.points.sigma_z_mm
        where = kept & done.truth.measured & shared
        before, after = (_error_um(done, p, where) for p in (view.points, points))
        alone.append(_trimmed_rms(before))
        together.append(_trimmed_rms(after))
        ratios.append(after / (1e3 * np.linalg.norm(points.sigma_xyz_mm[where], axis=-1)))
    return alone, together, MEDIAN_TO_SIGMA * float(np.median(np.concatenate(ratios)))


def _error_um(done: Measurement, points: PointMap, where: BoolImage) -> FloatArray:
    """Return the distances of points from the true ones of the same camera rays."""
    difference = points.points_world_mm[where] - done.truth.points_world_mm[where]
    return 1e3 * np.linalg.norm(difference.astype(np.float64), axis=-1)


def _trimmed_rms(error_um: FloatArray) -> float:
    used = error_um[error_um <= np.percentile(error_um, 99.0)]
    return float(np.sqrt(np.mean(used**2)))


def _empty_share(points_mm: FloatArray) -> float:
    """Return the share of the cells of the field without a point."""
    half = np.array(FIELD_MM)
    inside = points_mm[np.all(np.abs(points_mm[:, :2]) < half, axis=1)].astype(np.float64)
    filled = np.unique(SquareCells.of(inside, CELL_MM).number)
    return 1.0 - len(filled) / float(np.prod(2.0 * half / CELL_MM))


if __name__ == "__main__":
    main()

"""Figures and files of the displacements of printed dots, of real and of rendered sensors."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.errors import FitError
from reconstruction.markers import DotStatus, mean_motion
from reconstruction.photometric import GelMotion, write_dots

DOTS_FILE, DOTS_PICTURE = "markers.nc", "markers.png"


def write_motion(folder: Path, image: Levels, motion: GelMotion) -> None:
    """Write the displacements as `markers.nc`, and as arrows over the image in `markers.png`."""
    from reconstruction.photometric.pictures import draw_dots  # imports Matplotlib

    write_dots(folder / DOTS_FILE, motion)
    draw_dots(folder / DOTS_PICTURE, image, motion)


def dot_figures(motion: GelMotion) -> dict[str, Any]:
    """Return the figures of printed dots by name, units in the names.

    They are the number of dots per status, the largest displacement, the median uncertainty and, if
    four dots are tracked, those of `mean_motion`.
    """
    tracks, tracked = motion.tracks, motion.tracks.tracked
    figures: dict[str, Any] = {
        f"dots_{status.name.lower()}": int(np.count_nonzero(tracks.status == status))
        for status in DotStatus
    }
    figures["dot_diameter_um"] = 2e3 * tracks.pattern.radius_px * motion.pitch_mm
    figures["dot_spacing_um"] = 1e3 * tracks.pattern.spacing_px * motion.pitch_mm
    if tracked.any():
        figures["dots_moved_most_um"] = 1e3 * float(np.hypot(*motion.moved_mm[tracked].T).max())
        figures["dots_sigma_median_um"] = 1e3 * float(np.median(motion.sigma_mm[tracked]))
    with suppress(FitError):
        mean = mean_motion(motion.places_mm[tracked], motion.moved_mm[tracked])
        figures |= {
            "dots_mean_x_um": 1e3 * mean.x_mm,
            "dots_mean_y_um": 1e3 * mean.y_mm,
            "dots_divergence_permille": 1e3 * mean.divergence,
            "dots_shear_permille": 1e3 * mean.shear,
            "dots_rotation_mrad": 1e3 * mean.rotation_rad,
            "dots_rotation_sigma_mrad": 1e3 * mean.rotation_sigma_rad,
        }
    return figures

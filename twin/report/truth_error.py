"""Figure of the measurement error: world z against the true coated face, pixel by pixel."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import norm

from reconstruction.pipeline import Reconstruction
from twin.optics.stack import Truth
from twin.report.canvas import (
    FIT,
    MEASURED_FILL,
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    plain_spines,
    round_up,
    sequential,
    symmetric_limit,
)
from twin.report.world_map import average_on_grid

_MAP_CELLS, _BINS, _SIGMAS = 480, 121, 200


def draw_truth_error(
    path: Path, reconstruction: Reconstruction, truth: Truth, pixel_mm: float
) -> None:
    """Draw the error map, the predicted sigma and the histogram of errors as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    both = reconstruction.point_map.valid & truth.lit
    points = truth.points_world_mm[both]
    error_um = 1e3 * (reconstruction.point_map.points_world_mm[both] - points)[:, 2].astype(float)
    sigma_um = 1e3 * reconstruction.point_map.sigma_z_mm[both].astype(float)
    limit_um = symmetric_limit(error_um, 99.5)
    with drawing(path, 10.0, 6.7) as figure:
        shown = _map(
            axes_at(figure, 0.65, 0.35, 3.45, 2.65),
            "z error, measured − true face",
            (points, error_um, pixel_mm),
            {"cmap": diverging(), "vmin": -limit_um, "vmax": limit_um},
        )
        add_colorbar(shown.axes, shown, "z error (µm)", extend="both")
        top_um = round_up(float(np.percentile(sigma_um, 99)))
        shown = _map(
            axes_at(figure, 5.75, 0.35, 3.45, 2.65),
            "predicted σ of z, from camera noise",
            (points, sigma_um, pixel_mm),
            {"cmap": sequential(), "vmin": 0, "vmax": top_um},
        )
        add_colorbar(shown.axes, shown, "σ (µm)", extend="max")
        _histogram(axes_at(figure, 0.65, 3.95, 9.2, 2.2), error_um, sigma_um, limit_um)


def _map(
    axes: Axes, title: str, data: tuple[NDArray[Any], NDArray[Any], float], options: dict[str, Any]
) -> Any:
    points, values, pixel_mm = data
    cells = average_on_grid(points, values, pixel_mm, _MAP_CELLS)
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    return axes.imshow(cells.values, origin="lower", extent=cells.extent_mm, **options)


def _histogram(axes: Axes, error_um: NDArray[Any], sigma_um: NDArray[Any], limit_um: float) -> None:
    edges = np.linspace(-limit_um, limit_um, _BINS + 1)
    axes.hist(error_um, edges.tolist(), density=True, color=MEASURED_FILL, label="actual errors")
    axes.plot(
        edges,
        predicted_density(edges, sigma_um),
        color=FIT,
        lw=1.6,
        label="predicted from σ alone (no bias)",
    )
    axes.set(
        title="Errors of all scored pixels",
        xlabel="z error (µm)",
        ylabel="density (1/µm)",
        xlim=(-limit_um, limit_um),
    )
    axes.legend(loc="upper right")
    plain_spines(axes)


def predicted_density(error_um: NDArray[Any], sigma_um: NDArray[Any]) -> NDArray[np.float64]:
    """Density of zero-mean normal errors whose sigma differs from pixel to pixel.

    The mixture is taken over quantiles of sigma: enough of them look like all pixels.
    """
    levels = np.quantile(sigma_um, (np.arange(_SIGMAS) + 0.5) / _SIGMAS)
    levels = np.maximum(levels, 1e-9)
    return np.asarray(norm.pdf(error_um[:, None], scale=levels).mean(axis=1))

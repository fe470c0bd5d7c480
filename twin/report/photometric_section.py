"""Figure of photometric stereo along the section: every decoder's heights against the true coat."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from twin.report.canvas import (
    FIT,
    MEASURED,
    NOMINAL,
    TRUE_FACE,
    axes_at,
    drawing,
    plain_spines,
)
from twin.report.photometric_maps import decoder_name, extent_mm
from twin.report.section import Trace, face_profile, trace_through_apexes
from twin.results.decoders import DecodedImage
from twin.results.record import Measurement

_SAMPLES = 601
_COLOURS = {"corrected": MEASURED, "sdk_2025": FIT, "sdk_2024": NOMINAL}
_STYLES = {"polynomial": "-", "table": ":"}


def draw_sections(path: Path, seen: Measurement) -> None:
    """Draw heights and height errors of every decoder along the section, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    trace = trace_through_apexes(seen.experiment)
    left, right, *_ = extent_mm(seen)
    s_mm = np.linspace(left, right, _SAMPLES)
    true_mm = face_profile(seen.press, trace, s_mm)
    with drawing(path, 10.0, 6.9) as figure:
        heights = axes_at(figure, 0.65, 0.35, 9.2, 3.0)
        errors = axes_at(figure, 0.65, 4.0, 9.2, 2.4)
        heights.plot(s_mm, true_mm, color=TRUE_FACE, lw=2.4, alpha=0.6, label="true coat")
        for one in seen.colours.decoded:
            found_mm = profile_mm(one, seen, trace, s_mm)
            _line(heights, s_mm, found_mm, one)
            _line(errors, s_mm, 1e3 * (found_mm - true_mm), one)
        heights.set(title="Height along the section, z enlarged", ylabel="z (mm)")
        errors.set(title="Measured − true", ylabel="z error (µm)")
        errors.axhline(0.0, color=TRUE_FACE, lw=2.4, alpha=0.6)
        for axes in (heights, errors):
            axes.set(xlabel=f"{trace.axis} (mm)", xlim=(left, right))
            plain_spines(axes)
        heights.legend(loc="upper right")


def profile_mm(
    one: DecodedImage, seen: Measurement, trace: Trace, s_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return heights of one decoder at positions s, mm; NaN outside the image."""
    rows, cols = one.heights.height_mm.shape
    pitch_mm = one.heights.pitch_mm
    x_mm = (np.arange(cols) - (cols - 1) / 2) * pitch_mm
    y_mm = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    upwards = one.heights.height_mm[::-1].astype(np.float64)
    sample = RegularGridInterpolator((y_mm, x_mm), upwards, bounds_error=False)
    return np.asarray(sample(trace.points(s_mm)[:, ::-1]))


def _line(
    axes: Axes, s_mm: NDArray[np.float64], values: NDArray[np.float64], one: DecodedImage
) -> None:
    axes.plot(
        s_mm,
        values,
        color=_COLOURS[one.integration],
        ls=_STYLES[one.colour_map],
        lw=1.2,
        label=decoder_name(one),
    )

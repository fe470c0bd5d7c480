"""Classical methods that predict quantities of the samples of a data set, for comparison.

They read only what a user of a sensor has: recorded or decoded images and the calibration. Two
methods unwrap the phase spatially, which gives fringe orders relative to one pixel. At this pixel
alone they use the true order.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError
from reconstruction.evaluate.predictions import MASKS, PHASES, SCORED, PredictionScore
from reconstruction.evaluate.samples import LabelledSample, read_samples, read_schema
from reconstruction.reduction.fourier import LEAST_FRINGES, find_carrier, side_lobe
from reconstruction.rig.pinhole import Pinhole
from reconstruction.spatial_unwrapping import SECOND_DIFFERENCE, unwrap_spatially, wrapped

Array = NDArray[Any]
_TURN = 2.0 * np.pi
_COLUMN, _DEPTH = "phase_column_rad", "depth_mm"

LEAST_MODULATION = 0.1
"""Smallest modulation of a pixel that is unwrapped, relative to the 95th percentile of the image.
Assumed: fringes on the darkest material of the recipes have more, shadows less."""

_NORMAL_MAD = 1.4826  # standard deviation / median absolute deviation of a normal distribution


@dataclass(frozen=True)
class ClassicalMethod:
    """A classical method that predicts quantities of a sample from others.

    Attributes
    ----------
    inputs : names of the arrays that it needs, by the quantity that it predicts
    predict : function (sample, quantity) that returns the prediction
    """

    inputs: Mapping[str, tuple[str, ...]]
    predict: Callable[[LabelledSample, str], Array]


def score_baseline(
    name: str,
    dataset: Path,
    split: str = "test",
    method: str = "",
    quantities: Collection[str] = SCORED,
) -> PredictionScore:
    """Score a classical method of `BASELINES` against a data set that contains its input.

    Parameters
    ----------
    split : "train", "validation", "test" or "all"
    method : method of measurement; empty for a data set of one
    quantities : those of `SCORED` that are scored, if the method predicts them

    Raises
    ------
    InputError : the classical method is not known, the data set lacks its input or the truth, or a
        sample is not suited to it
    """
    held = read_schema(dataset).arrays_of(method)
    scored = tuple(quantity for quantity in predicted_by(name, held) if quantity in quantities)
    needs = BASELINES[name].inputs
    if not scored:
        raise InputError(f"{dataset}: --baseline {name} needs {needs_of(name)} in sample.hold")
    inputs = {array for quantity in scored for array in needs[quantity]}
    result = PredictionScore(scored)
    for sample in read_samples(dataset, split, {*scored, *inputs, *MASKS}, method):
        able = [q for q in scored if {*needs[q]} <= sample.arrays.keys()]
        result.add(sample, {q: BASELINES[name].predict(sample, q) for q in able})
    return result


def predicted_by(name: str, held: Collection[str]) -> tuple[str, ...]:
    """Return the quantities that a classical method predicts from the arrays of a sample.

    Raises
    ------
    InputError : the classical method is not known
    """
    if name not in BASELINES:
        raise InputError(f"--baseline: found '{name}', allowed: {', '.join(BASELINES)}")
    inputs = BASELINES[name].inputs.items()
    return tuple(q for q, needed in inputs if q in held and {*needed} <= {*held})


def needs_of(name: str) -> str:
    """Return the arrays that a classical method needs, in words."""
    inputs = BASELINES[name].inputs.items()
    return "; or ".join(f"{quantity} with {', '.join(needed)}" for quantity, needed in inputs)


def _decoded(sample: LabelledSample, quantity: str) -> Array:
    """Return the result of the decoder of the twin; NaN at masked pixels."""
    known = sample.arrays[f"decoded_{quantity}"].astype(np.float32)
    mask = sample.arrays["decoded_reason"] == 0
    return np.where(mask[..., None] if known.ndim > mask.ndim else mask, known, np.float32(np.nan))


def _unwrapped(sample: LabelledSample, quantity: str) -> Array:
    """Unwrap the decoded phase of the single pixels by quality-guided spatial unwrapping."""
    wrapped_rad = sample.arrays[f"decoded_wrapped_{quantity}"].astype(np.float64)
    modulation = sample.arrays[_modulation_along(quantity)]
    return absolute_phase(wrapped_rad, modulation, sample.arrays[quantity])


def _modulation_along(quantity: str) -> str:
    """Return the name of the modulation along the axis of a phase."""
    return quantity.replace("phase", "decoded_modulation").replace("rad", "dn")


def _fourier(sample: LabelledSample, quantity: str) -> Array:
    """Return phase or depth from the first frame alone, by Fourier transform and unwrapping."""
    wrapped_rad, modulation = phase_of_frame(sample.arrays["frames"][0])
    phase = absolute_phase(wrapped_rad, modulation, sample.arrays[_COLUMN])
    return phase if quantity == _COLUMN else depth_of_phase(phase, sample)


def phase_of_frame(frame_dn: Array) -> tuple[FloatArray, FloatArray]:
    """Return phase, rad in [-pi, pi], and modulation, DN, of one image of column fringes.

    The mean level is the image smoothed over several fringes, as in `reduction.fourier`. The phase
    is taken to increase along the columns of the camera.

    Parameters
    ----------
    frame_dn : (row, col), DN

    Raises
    ------
    InputError : the image has no fringes, see `find_carrier`
    """
    frame = frame_dn.astype(np.float64)
    smooth_px = max(frame.shape) / (2.0 * LEAST_FRINGES)
    fringes_dn = frame - ndimage.gaussian_filter(frame, smooth_px)
    lobe = side_lobe(fringes_dn, find_carrier(fringes_dn, "column"))
    return np.angle(lobe), 2.0 * np.abs(lobe)


def absolute_phase(wrapped_rad: FloatArray, modulation: Array, true_rad: Array) -> FloatArray:
    """Return the unwrapped phase, (row, col) rad, of the largest island; NaN outside it.

    Parameters
    ----------
    wrapped_rad, modulation : (row, col); phase and amplitude of the fringes. Pixels with less than
        `LEAST_MODULATION` are not used
    true_rad : (row, col); read at one pixel only, the lit pixel that is nearest to the middle of
        the island
    """
    amplitude = modulation.astype(np.float64)
    usable = amplitude > LEAST_MODULATION * np.percentile(amplitude, 95.0)
    turns = wrapped_rad / _TURN
    sigma = _sigma_turns(turns, amplitude, usable)
    relative = unwrap_spatially(turns.astype(np.float32), sigma.astype(np.float32), usable)
    known = (relative.islands == 1) & (true_rad != 0)
    if not known.any():
        return np.full(turns.shape, np.nan)
    rows, cols = np.nonzero(known)
    middle = np.argmin(np.hypot(rows - rows.mean(), cols - cols.mean()))
    at = rows[middle], cols[middle]
    first = np.rint(true_rad[at] / _TURN - turns[at] - relative.orders[at])
    absolute = _TURN * (turns + relative.orders + first)
    return np.where(relative.islands == 1, absolute, np.nan)


def _sigma_turns(turns: FloatArray, amplitude: FloatArray, usable: BoolImage) -> FloatArray:
    """Return the standard deviation of the phase, (row, col) turns, from its own scatter.

    It is inversely proportional to the amplitude. The factor is the robust standard deviation of
    the second differences along the rows, of which the surface has few large ones.
    """
    second = np.diff(wrapped(np.diff(turns, axis=1)), axis=1)
    triple = usable[:, :-2] & usable[:, 1:-1] & usable[:, 2:]
    scatter = np.abs(wrapped(second) * amplitude[:, 1:-1])[triple]
    noise = _NORMAL_MAD * float(np.median(scatter)) if scatter.size else 0.0
    least = float(amplitude[usable].min()) if usable.any() else 1.0
    return np.asarray(noise / np.sqrt(SECOND_DIFFERENCE) / np.maximum(amplitude, least))


def depth_of_phase(phase_rad: FloatArray, sample: LabelledSample) -> FloatArray:
    """Return the depth, (row, col) mm, at which camera rays meet the planes of projector columns.

    Parameters
    ----------
    phase_rad : (row, col) absolute phase along columns; NaN: no phase

    Raises
    ------
    InputError : the sample has no calibration or no period, its projector has a distorting lens,
        or there are layers above the surface
    """
    rig = sample.calibration
    if "column" not in rig.get("periods_px", {}) or "layers" in rig:
        raise InputError(
            f"{sample.key}: calibration.json: needs periods_px.column, and no layers; make the "
            "data set again with column fringes in air"
        )
    camera, projector = (_pinhole(rig[name]) for name in ("camera", "projector"))
    if any(projector.distortion):
        raise InputError(
            f"{sample.key}: calibration.json: found a projector lens with distortion, allowed none"
        )
    column_px = phase_rad / _TURN * rig["periods_px"]["column"]
    rows, cols = np.indices(phase_rad.shape)
    slopes = camera.unproject(np.stack([cols, rows], axis=-1))
    T = np.linalg.inv(np.array(rig["T_world_from_proj"])) @ np.array(rig["T_world_from_cam"])
    ray = np.concatenate([slopes, np.ones((*phase_rad.shape, 1))], axis=-1) @ T[:3, :3].T
    slope = (column_px - projector.cx_px) / projector.fx_px
    # The point depth * ray + T[:3, 3] of the projector's frame is on the plane x = slope z.
    return np.asarray((slope * T[2, 3] - T[0, 3]) / (ray[..., 0] - slope * ray[..., 2]))


def _pinhole(tree: Mapping[str, Any]) -> Pinhole:
    matrix = tree["camera_matrix"]
    return Pinhole(
        tree["image_width"],
        tree["image_height"],
        matrix[0][0],
        matrix[1][1],
        matrix[0][2],
        matrix[1][2],
        tuple(tree["distortion_coefficients"]),
    )


BASELINES: Mapping[str, ClassicalMethod] = {
    "decoded": ClassicalMethod(
        {name: (f"decoded_{name}", "decoded_reason") for name in SCORED}, _decoded
    ),
    "spatial_unwrapping": ClassicalMethod(
        {name: (f"decoded_wrapped_{name}", _modulation_along(name)) for name in PHASES},
        _unwrapped,
    ),
    "fourier": ClassicalMethod({_COLUMN: ("frames",), _DEPTH: ("frames", _COLUMN)}, _fourier),
}
"""Classical methods by name, for comparison with predictions."""

"""Level, contrast and sigma of the fringes at every pixel in closed form; clipped frames.

The formulas are in the table of `twin.results.prediction`.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Reason, ReasonImage
from reconstruction.decoding import DecodeOptions
from reconstruction.patterns import AXES, Axis
from reconstruction.pixel_shape import smear_px, width_over_height
from reconstruction.rig.sensor import QUANTISATION_DN2
from twin.camera import electrons_per_ms, noise_model
from twin.config.models import Experiment
from twin.optics.contrast import FringeLight, extent_variance_px2, outline, transfer
from twin.optics.light import Defocus, pattern_set
from twin.optics.stack import TraceMaps


@dataclass(frozen=True)
class FringeNumbers:
    """Numbers that link the irradiance of a pixel to the sigma of its decoded coordinate.

    They are complex if a derivative is computed by a complex step.

    Attributes
    ----------
    electrons_per_radiance : e- per mW / (mm^2 sr), during the exposure
    dark_e : dark current during the exposure, e-
    gain_dn_per_e : gain of the camera, DN / e-
    read_noise_e : standard deviation of the read noise, e-
    mean, amplitude : mean and amplitude of the fringes, as shares of white
    blur_px : standard deviation of the projector's blur in focus, projector px
    growth_px_mm, focus_mm : growth of the blur with the distance, and distance of the focus, see
        `Defocus`; 0 and 1 without defocus
    period_px : finest period of the fringes, projector px
    rows_per_column : width of a projector column in rows
    column_smear_px2, row_smear_px2 : variance that the shape of the pixels adds, px^2
    """

    electrons_per_radiance: Any
    dark_e: Any
    gain_dn_per_e: Any
    read_noise_e: Any
    mean: Any
    amplitude: Any
    blur_px: Any
    growth_px_mm: Any
    focus_mm: Any
    period_px: Any
    rows_per_column: Any
    column_smear_px2: Any
    row_smear_px2: Any

    @classmethod
    def of(cls, experiment: Experiment, exposure_ms: float) -> "FringeNumbers":
        """Return these numbers for camera, projector and patterns of an experiment."""
        camera, projector = experiment.camera, experiment.projector
        sensor, light = noise_model(camera), FringeLight.of(projector, experiment.patterns)
        blur = Defocus.of(projector) or Defocus(projector.blur_px, 0.0, 1.0)
        return cls(
            electrons_per_radiance=exposure_ms * electrons_per_ms(camera, projector.wavelength_nm),
            dark_e=camera.dark_current_e_per_s * camera.binning**2 * exposure_ms * 1e-3,
            gain_dn_per_e=sensor.gain_dn_per_e,
            read_noise_e=sensor.read_noise_e,
            mean=light.mean,
            amplitude=light.amplitude,
            blur_px=blur.blur_px,
            growth_px_mm=blur.growth_px_mm,
            focus_mm=blur.focus_mm,
            period_px=experiment.patterns.period_px,
            rows_per_column=width_over_height(projector.pixel_ratio),
            column_smear_px2=smear_px(projector.pixel_ratio, "column") ** 2 / 12.0,
            row_smear_px2=smear_px(projector.pixel_ratio, "row") ** 2 / 12.0,
        )

    def moved(self, along: "FringeNumbers", step: complex) -> "FringeNumbers":
        """Return the numbers plus `step` times their derivatives `along`."""
        names = [field.name for field in fields(self)]
        return FringeNumbers(**{n: getattr(self, n) + step * getattr(along, n) for n in names})

    def blur_px2(self, axial_mm: Any, axis: Axis) -> Any:
        """Return the variance of the blur along an axis, px^2, at axial distances, mm.

        The distances are from the projector. The blur includes the shape of pixels that are not
        rectangular.
        """
        blur = Defocus(self.blur_px, self.growth_px_mm, self.focus_mm).variance_px2(axial_mm)
        if axis == "column":
            return blur + self.column_smear_px2
        return blur * self.rows_per_column**2 + self.row_smear_px2


@dataclass(frozen=True)
class Steps:
    """Phase shifting along one axis: all periods over the finest one, and number of steps."""

    ratios: tuple[float, ...]
    count: int


def white_radiance(maps: TraceMaps, experiment: Experiment) -> FloatImage:
    """Return the radiance of the white frame, (row, col) float32, mW / (mm^2 sr)."""
    numbers = FringeNumbers.of(experiment, 1.0)
    return np.asarray(maps.weight * outlines(maps, numbers, experiment), np.float32)


def outlines(maps: TraceMaps, numbers: FringeNumbers, experiment: Experiment) -> Any:
    """Return the relative light of a white image with blurred edges at each pixel, (row, col).

    It is 1 far inside the projected image and 0 far outside.
    """
    projector = experiment.projector
    across, down = (np.sqrt(numbers.blur_px2(maps.axial_mm, axis)) for axis in AXES)
    along = outline(maps.column_px, projector.width_px, across)
    return along * outline(maps.row_px, projector.height_px, down)


@dataclass(frozen=True, eq=False)
class AxisLevels:
    """Levels and sigma of the fringes along one axis at each pixel, (row, col).

    Attributes
    ----------
    light_dn : mean of the fringes above the black level, DN
    modulation_dn : amplitude of the fringes of the finest period, DN
    sigma_px : standard deviation of the coordinate of a single pixel before the filter, projector
        px; computed as if no frame were clipped, see `clipping`
    phase_sigma_rad : largest standard deviation of the phase among the periods, rad
    """

    light_dn: Any
    modulation_dn: Any
    sigma_px: Any
    phase_sigma_rad: Any


def axis_levels(
    maps: TraceMaps, numbers: FringeNumbers, steps: Steps, axis: Axis, white: Any
) -> AxisLevels:
    """Return levels and sigma of the fringes along one axis in closed form.

    The formulas are analytic in maps and numbers, so that complex steps give derivatives.

    Parameters
    ----------
    white : (row, col) radiance of the white frame, mW / (mm^2 sr)
    """
    electrons = white * numbers.electrons_per_radiance
    light_dn = numbers.gain_dn_per_e * (electrons * numbers.mean + numbers.dark_e)
    reach = maps.column_range_px if axis == "column" else maps.row_range_px
    blur = numbers.blur_px2(maps.axial_mm, axis) + extent_variance_px2(reach, maps.samples)
    read_dn = numbers.gain_dn_per_e * numbers.read_noise_e
    noise = np.sqrt(read_dn**2 + numbers.gain_dn_per_e * light_dn + QUANTISATION_DN2)
    modulations, information, worst = [], 0.0, 0.0
    for ratio in steps.ratios:
        period = ratio * numbers.period_px
        contrast = transfer(period, blur)
        modulation = numbers.gain_dn_per_e * electrons * numbers.amplitude * contrast
        phase = np.sqrt(2.0 / steps.count) * noise / _not_zero(modulation)
        information = information + (2.0 * np.pi / (period * phase)) ** 2
        modulations.append(modulation)
        worst = np.maximum(worst, phase)
    return AxisLevels(light_dn, modulations[0], 1.0 / np.sqrt(information), worst)


def _not_zero(values: Any) -> Any:
    return np.where(np.real(values) > 1e-12, values, 1e-12)


def steps_of(experiment: Experiment, axis: Axis) -> Steps:
    """Return periods and number of phase steps of an experiment's fringes along one axis."""
    patterns = pattern_set(experiment.projector, experiment.patterns)
    finest_px = experiment.patterns.period_px
    ratios = tuple(period / finest_px for period in patterns.fused_periods(axis))
    return Steps(ratios, patterns.steps)


def clipping(
    experiment: Experiment, levels: AxisLevels, place_px: FloatArray, axis: Axis,
    reason: ReasonImage,
) -> FloatArray:  # fmt: skip
    """Return the factor (row, col) by which clipped frames increase sigma.

    The decoder fits the phase by least squares to the frames below the limit, see
    `_phase.refit_row`. Pixels with too few such frames, or with a clipped mean, are marked in
    `reason` as saturated.
    """
    sensor, growth = noise_model(experiment.camera), np.ones(reason.shape)
    limit = sensor.clipped_from_dn - sensor.black_level_dn
    at = (reason == 0) & (levels.light_dn + levels.modulation_dn > limit)
    if not at.any():
        return growth
    patterns = pattern_set(experiment.projector, experiment.patterns)
    shift = 2.0 * np.pi * np.array(patterns.shifts(axis, 0))
    phase = 2.0 * np.pi * place_px[at] / patterns.period_along(axis)
    frames = np.cos(phase[:, None] + shift)
    good = levels.light_dn[at, None] + levels.modulation_dn[at, None] * frames < limit
    root = np.sqrt(2.0)
    basis = np.stack([np.ones_like(shift), root * np.cos(shift), -root * np.sin(shift)], axis=1)
    matrix = np.einsum("pn,na,nb->pab", good.astype(np.float64), basis, basis)
    matrix += 1e-9 * np.eye(3)  # for a pixel without a good frame
    inverse = np.linalg.inv(matrix)
    size = np.linalg.norm(matrix, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2)) / 3.0
    lost = (good.sum(axis=1) < 3) | (size > DecodeOptions.max_condition)
    if patterns.word_bits(axis) and not patterns.inverse:
        lost |= levels.light_dn[at] >= limit  # the mean is the threshold of the bits
    turned = np.stack([np.zeros_like(phase), -np.sin(phase), np.cos(phase)], axis=1)
    spread = patterns.steps * np.einsum("pa,pab,pb->p", turned, inverse, turned)
    growth[at] = np.where(lost, 1.0, np.sqrt(np.maximum(spread, 1.0)))
    marked = reason[at]
    marked[lost] = Reason.SATURATED
    reason[at] = marked
    return growth

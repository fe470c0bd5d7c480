"""Displacements of the printed dots of a rendered photometric sensor, and their true values.

The dots are tracked from the background to the image of the press, as those of real sensors. The
true displacement of a dot is that of its material point, by the model of the elastomer. Models
that compute no displacement in the plane of the coat leave the dots at their x and y.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.errors import FitError
from reconstruction.photometric import GelMotion
from reconstruction.photometric.printed_dots import DotOptions, GelMotionField, SensorDots
from twin.config import Experiment
from twin.config.lamps import Markers
from twin.config.layers import holding_layer, raised_mm
from twin.mechanics import PressedElastomer, material_points
from twin.optics.stack import Truth
from twin.results.dot_figures import dot_figures

NO_DOTS = (
    "photometric.markers: found fewer than six similar dots in the image without contact, so their"
    " displacement is not measured; use larger or darker dots"
)
# Rounds of the inversion from material points to places, which converges by the factor of the
# strain; strains are below 0.5.
_ROUNDS = 50
# Gel that must be visible around a dot, px: as for the fit of a dot.
_RIM_PX = 2


def sensor_dots(
    experiment: Experiment, background: FloatImage, smoothing_px: int
) -> SensorDots | None:
    """Return the printed dots of a sensor from its background (row, col, 3), levels.

    None if no dots are printed, or if the background shows fewer than six similar ones.

    Parameters
    ----------
    smoothing_px : see `SensorDots.of`
    """
    if experiment.photometric.markers is None:
        return None
    layers, standoff_mm = experiment.layers, experiment.camera.pose.standoff_mm
    gel = holding_layer(layers)
    distance_mm = (standoff_mm - raised_mm(layers)) * (1.0 if gel is None else gel.ior)
    options = DotOptions(experiment.photometric.gamma, distance_mm)
    try:
        return SensorDots.of(background, options, smoothing_px)
    except FitError:
        return None


@dataclass(frozen=True, eq=False)
class MeasuredDots:
    """Measured displacements of printed dots, and their truth.

    Attributes
    ----------
    motion : measured displacements; None: the background shows no pattern of dots
    true_mm : (dot, xy) true displacements of the dots of `motion`
    field : smooth field of the tracked dots; None: fewer than six are tracked
    field_true_mm : (row, col, xy) true displacements of the places of `field`
    in_image : number of printed dots that the image of the press shows as a whole
    """

    motion: GelMotion | None
    true_mm: FloatArray
    field: GelMotionField | None
    field_true_mm: FloatArray
    in_image: int

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line if no dots were detected."""
        return (NO_DOTS,) if self.motion is None else ()

    @property
    def figures(self) -> dict[str, float]:
        """Figures of the dots by name: those of `dot_figures`, and errors against the truth.

        Errors are those of the tracked dots, and of the field between them. A normalised error is
        the RMS of error over standard uncertainty, 1 if the uncertainty is right.
        """
        figures: dict[str, float] = {"dots_in_image": self.in_image, "dots_tracked": 0}
        if self.motion is None:
            return figures  # `warnings` states the reason
        figures |= dot_figures(self.motion)
        tracked = self.motion.tracks.tracked
        if tracked.any():
            error_mm = (self.motion.moved_mm - self.true_mm)[tracked]
            true_um = 1e3 * np.hypot(*self.true_mm[tracked].T)
            figures["dots_true_displacement_rms_um"] = _rms(true_um)
            figures["dots_displacement_error_rms_um"] = 1e3 * _rms(error_mm)
            figures["dots_error_over_sigma"] = _rms(error_mm / self.motion.sigma_mm[tracked])
            spacing_mm = self.motion.tracks.pattern.spacing_px * self.motion.pitch_mm
            wrong = np.hypot(*error_mm.T) > 0.5 * spacing_mm
            figures["dots_assigned_wrongly"] = int(np.count_nonzero(wrong))
        if self.field is not None:
            error_mm = self.field.moved_mm - self.field_true_mm
            figures["dots_field_error_rms_um"] = 1e3 * _rms(error_mm)
            figures["dots_field_error_over_sigma"] = _rms(error_mm / self.field.sigma_mm)
        return figures


def measured_dots(
    experiment: Experiment, motion: GelMotion | None, truth: Truth, pressed: PressedElastomer
) -> MeasuredDots:
    """Return measured displacements with their truth; the experiment has printed dots.

    Parameters
    ----------
    motion : measured displacements; None: the background shows no pattern of dots
    """
    markers = experiment.photometric.markers
    assert markers is not None
    coat = _Material.of(experiment, pressed)
    in_image = _in_image(markers, coat, truth)
    if motion is None:
        return MeasuredDots(None, np.zeros((0, 2)), None, np.zeros((0, 0, 2)), in_image)
    pitch_mm = np.array([markers.pitch_x_mm, markers.pitch_y_mm])
    true_mm = coat.displacement_mm(np.round(motion.places_mm / pitch_mm) * pitch_mm)
    try:
        field = motion.field()
    except FitError:
        return MeasuredDots(motion, true_mm, None, np.zeros((0, 0, 2)), in_image)
    return MeasuredDots(motion, true_mm, field, coat.displacement_mm(field.places_mm), in_image)


@dataclass(frozen=True, eq=False)
class _Material:
    """Material coordinates minus x and y over the pressed coat, mm, as a function of x and y."""

    shift: RegularGridInterpolator

    @classmethod
    def of(cls, experiment: Experiment, pressed: PressedElastomer) -> "_Material":
        x_mm, y_mm = pressed.face_x_mm, pressed.face_y_mm
        X_mm, Y_mm = material_points(pressed, experiment.elastomer, experiment.press)
        off = np.stack([X_mm - x_mm, Y_mm - y_mm[:, None]], axis=-1)
        return cls(RegularGridInterpolator((y_mm, x_mm), off, bounds_error=False, fill_value=0.0))

    def displacement_mm(self, material_mm: FloatArray) -> FloatArray:
        """Return the displacements (..., xy) of material points (..., xy)."""
        moved = np.zeros_like(material_mm)
        for _ in range(_ROUNDS):
            moved = -self.shift((material_mm + moved)[..., ::-1])
        return moved


def _in_image(markers: Markers, coat: _Material, truth: Truth) -> int:
    """Return the number of dots that the image of the press shows as a whole, with their rim."""
    points_mm = truth.points_world_mm[..., :2].astype(np.float64)
    rows, cols = truth.measured.shape
    step_mm = np.hypot(*(points_mm[rows // 2, cols // 2] - points_mm[rows // 2, cols // 2 - 1]))
    rim_px = int(np.ceil(markers.radius_mm / step_mm)) + _RIM_PX
    reach = np.abs(points_mm).max(axis=(0, 1)) // (markers.pitch_x_mm, markers.pitch_y_mm) + 1.0
    i, j = np.meshgrid(*(np.arange(-most, most + 1.0) for most in reach))
    lattice = np.column_stack([i.ravel() * markers.pitch_x_mm, j.ravel() * markers.pitch_y_mm])
    nearest = KDTree(points_mm.reshape(-1, 2)).query(lattice + coat.displacement_mm(lattice))[1]
    row, col = np.divmod(nearest, cols)
    inside = np.minimum(row, col) >= rim_px
    inside &= (row < rows - rim_px) & (col < cols - rim_px) & truth.measured[row, col]
    return int(np.count_nonzero(inside))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

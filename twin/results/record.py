"""Record of a measurement by any method: points, truth, score, images, figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatImage, Levels, Reason
from reconstruction.capture.folder import Capture, read_capture
from reconstruction.photometric import HeightMap, SensorCalibration
from reconstruction.pipeline import Reconstruction
from twin.config import Experiment
from twin.config.quantities import outside_sources
from twin.mechanics import PressedElastomer
from twin.optics.rig import camera_pinhole
from twin.optics.stack import Frames, RadianceStack, Truth
from twin.results.decoders import DecodedImage
from twin.results.figures import Figures, Metrics, warnings_of
from twin.results.object_score import MeasuredQuantity, ObjectScore, score_object
from twin.results.printed_dots import MeasuredDots
from twin.results.score import Scores, TruthScore, in_world
from twin.results.under_sheet import SheetCompensation

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Measured points, one per camera pixel: of the coat, or of the bare specimen.

    Attributes
    ----------
    world_mm : (row, col, xyz) float, position in the world frame, mm
    reason : (row, col) uint8, codes of `reconstruction.arrays.Reason`
    sigma_z_mm : (row, col) float32, standard deviation of world z, mm; None if the method predicts
        none
    """

    world_mm: NDArray[np.floating[Any]]
    reason: Levels
    sigma_z_mm: FloatImage | None = None

    @property
    def valid(self) -> BoolImage:
        """Mask (row, col) of the pixels that have a point."""
        return np.asarray(self.reason == Reason.VALID)


@dataclass(frozen=True, eq=False)
class Recording:
    """Images that the virtual rig delivers, and the truth, which a real rig does not have.

    `radiance` has the radiance of every frame with the truth; `capture` has the recorded images.
    """

    radiance: RadianceStack
    capture: Capture
    exposure_ms: float

    @property
    def truth(self) -> Truth:
        """True geometry at every camera pixel."""
        return self.radiance.truth


@dataclass(frozen=True, eq=False)
class Fringes:
    """Images of fringe projection, and the points reconstructed from them.

    Attributes
    ----------
    stored : the capture, or its folder, which is read at first use (600 MB at full size)
    reconstruction : decoded coordinates and points
    frames : linear radiance of every frame; None if the measurement was read from files
    """

    stored: Capture | Path
    reconstruction: Reconstruction
    frames: Frames | None = None

    @cached_property
    def capture(self) -> Capture:
        """Images that the camera recorded, with rig and patterns; read at first use.

        Raises
        ------
        CaptureError : the folder is incomplete or damaged
        """
        return read_capture(self.stored) if isinstance(self.stored, Path) else self.stored

    @cached_property
    def points(self) -> SurfacePoints:
        """Reconstructed points of the surface."""
        points = self.reconstruction.point_map
        return SurfacePoints(
            points.points_world_mm, np.asarray(points.mask_reason, np.uint8), points.sigma_z_mm
        )

    @property
    def picture(self) -> Levels:
        """First frame of the capture, (row, col) uint8, scaled so that 255 is saturation."""
        share = self.capture.stack[0] / np.float32(self.capture.sensor.saturation_dn)
        return np.asarray(np.rint(255 * np.clip(share, 0.0, 1.0)), np.uint8)


@dataclass(frozen=True, eq=False)
class Colours:
    """Image of a photometric sensor, and the heights by every decoder.

    Attributes
    ----------
    picture : (row, col, rgb) uint8 image
    calibrations : by kind of colour map, the sensor's calibration from the same reference images
    decoded : the image as decoded by every decoder
    own : the image as decoded by the decoder that the experiment selects
    dots : displacements of the printed dots; None: no dots are printed
    """

    picture: Levels
    calibrations: Mapping[str, SensorCalibration]
    decoded: list[DecodedImage]
    own: DecodedImage
    dots: MeasuredDots | None = None

    @property
    def calibration(self) -> SensorCalibration:
        """Calibration with the colour map that the experiment selects."""
        return self.calibrations[self.own.colour_map]

    @property
    def heights(self) -> HeightMap:
        """Heights by the decoder that the experiment selects."""
        return self.own.heights

    @property
    def points(self) -> SurfacePoints:
        """Points of the surface in the world frame, from `heights`."""
        reason = np.where(self.heights.valid, Reason.VALID, Reason.LOW_MODULATION)
        return SurfacePoints(in_world(self.heights), reason.astype(np.uint8))


def _length(measured: MeasuredQuantity) -> str:
    k = measured.uncertainty.coverage_factor
    return f"{measured.value:.4f} mm +- {measured.uncertainty.expanded:.2g} um (k = {k:g})"


@dataclass(frozen=True, eq=False)
class Measurement:
    """One measurement with all its results.

    Attributes
    ----------
    experiment : the measured experiment
    images : `Fringes` or `Colours`, depending on the method
    truth : true geometry at every camera pixel
    score : errors against the truth
    metrics : content of `result.json`; `figures` are its numbers, `warnings` its warnings
    pressed : the pressed elastomer; None if the bare specimen is measured
    digest, versions : digest of the experiment, and versions of the software by package
    seconds : wall-clock time by stage, s
    compensation : reconstruction of the object under a thin sheet; None if no sheet was pressed
    pressed_at_ends : elastomer at the start and at the end of the sequence of a moving press;
        empty without one
    """

    experiment: Experiment
    images: Fringes | Colours
    truth: Truth
    score: Scores[TruthScore]
    metrics: Metrics
    pressed: PressedElastomer | None
    digest: str
    versions: Mapping[str, str]
    seconds: Mapping[str, float] = field(default_factory=dict)
    compensation: SheetCompensation | None = None
    pressed_at_ends: tuple[PressedElastomer, ...] = ()

    def __repr__(self) -> str:
        rows, cols = self.points.reason.shape
        figures = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        name, modality = self.experiment.name, self.experiment.modality
        return f"<Measurement {name}: {modality}, {rows} x {cols} pixels, {figures}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html(
            f"{self.experiment.name} ({self.experiment.modality})", self._in_short(), self.plot()
        )

    def _in_short(self) -> dict[str, str]:
        """Return the main figures as texts by name."""
        score = self.score.against_truth
        shown = {
            measured.measurand.name.replace("_", " "): _length(measured)
            for measured in self.object.quantities
            if measured.value is not None and measured.measurand.unit == "mm"
        }
        shown |= {"points": f"{100 * self.points.valid.mean():.1f} % of all pixels"}
        if score.z_rmse_um is not None:
            shown["error of z"] = f"{score.z_rmse_um:.3g} um RMS"
        if self.pressed is not None:
            shown["force"] = f"{self.pressed.force_n:.3g} N"
        return shown | {"warnings": str(len(self.warnings))}

    def plot(self) -> "Drawing":
        """Draw relief, deviation from the true surface, and a section into a Matplotlib figure.

        Raises
        ------
        InputError : no pixel has a point
        """
        from twin.results.drawing import measurement_drawing

        return measurement_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return measured z, true z, deviation and sigma over camera pixels, with units.

        World x and y are coordinates. Pixels without a point are NaN except in the map of true z,
        and `mask_reason` gives the reason. True z is NaN at pixels that do not show the measured
        surface. Sigma is missing if the method predicts none.
        """
        from twin.results.drawing import measurement_arrays

        return measurement_arrays(self).to_xarray()

    @cached_property
    def figures(self) -> Figures:
        """Numerical results by name, which ends with the unit; None if a figure has no value."""
        return Figures(self.metrics)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of press and measurement, and of values outside the range of their source."""
        known = (*warnings_of(self.metrics), *outside_sources(self.experiment))
        return tuple(dict.fromkeys(known))

    @property
    def points(self) -> SurfacePoints:
        """Measured points, one per camera pixel: of the coat, or of the bare specimen."""
        return self.images.points

    @cached_property
    def object(self) -> ObjectScore:
        """Score of the object itself: deviation from the truth, and measurands.

        Raises
        ------
        InputError : a measurand names a part that the specimen does not have
        """
        measured = self.points
        points, known = (measured.world_mm, measured.valid, measured.sigma_z_mm), self.compensation
        return score_object(self.experiment, points, self.truth, self.pressed, known)

    def with_object(self) -> "Measurement":
        """Return the measurement with the figures of the object added to its metrics."""
        return self.with_same_object(metrics={**self.metrics, **self.object.figures})

    def with_same_object(self, **changes: Any) -> "Measurement":
        """Return the measurement with other fields, and with the score of the object, if computed.

        For fields on which this score does not depend: metrics, times, and all fields that are read
        back equal from a folder.
        """
        done = replace(self, **changes)
        if "object" in self.__dict__:
            done.__dict__["object"] = self.object
        return done

    @property
    def picture(self) -> Levels:
        """Camera image: first fringe frame (row, col), or colour image (row, col, rgb)."""
        return self.images.picture

    @property
    def press(self) -> PressedElastomer:
        """The pressed elastomer; TypeError if the method has no press."""
        if self.pressed is None:
            raise TypeError(f"{self.experiment.modality} presses nothing")
        return self.pressed

    @property
    def pixel_mm(self) -> float:
        """Width of a camera pixel at the height z = 0 of the world, mm.

        The undeformed coated face is at this height, or the highest point of a bare specimen.
        """
        if isinstance(self.images, Colours):
            return self.images.heights.pitch_mm
        camera = self.experiment.camera
        return camera.pose.standoff_mm / camera_pinhole(camera).fx_px

    @property
    def fringes(self) -> Fringes:
        """Images and points of fringe projection; TypeError for another method."""
        if not isinstance(self.images, Fringes):
            raise TypeError(f"{self.experiment.modality} takes no fringes")
        return self.images

    @property
    def colours(self) -> Colours:
        """Image and heights of photometric stereo; TypeError for another method."""
        if not isinstance(self.images, Colours):
            raise TypeError(f"{self.experiment.modality} takes no colours")
        return self.images

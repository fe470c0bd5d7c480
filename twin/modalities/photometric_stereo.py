"""Photometric stereo: the coat in the light of coloured lamps, seen through its gel.

One sensor sees everything: reference balls that teach it which colour goes with which slope, the
untouched gel, and the specimen. All of them are pressed, rendered and developed alike.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import Doubles, Levels
from reconstruction.errors import InputError
from reconstruction.photometric import (
    BallPress,
    HeightMap,
    SensorCalibration,
    calibrate_sensor,
)
from reconstruction.photometric.calibration_ball import SampleOptions
from reconstruction.photometric.sensor_calibration import MapKind
from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment
from twin.config.models import Ball
from twin.mechanics import PressedElastomer, face_mesh
from twin.modalities.colour_images import (
    cropped_pinhole,
    develop,
    image_pinhole,
    with_fixed_exposure,
)
from twin.modalities.contact_fpp import press_smooth, press_specimen, with_texture
from twin.modalities.photometric_decoders import MAP_ORDER, Decoded, chosen, decode_all
from twin.modalities.photometric_score import PhotometricScore
from twin.modalities.progress import Stopwatch, Watcher, nobody
from twin.modalities.reference_balls import ball_presses, with_ball
from twin.optics.backend import activate
from twin.optics.rig import world_from_device
from twin.optics.stack import Truth

if TYPE_CHECKING:
    import trimesh

    from twin.optics.colour_trace import ColourScene

FloatArray = NDArray[np.float32]

# Dots of the product are read up to this grey level (measured behaviour of the vendor's programs).
MARKER_LEVEL = 70
# A small ball in a dark corner now and then leaves no circle: such a press would be repeated.
UNREADABLE_SHARE = 0.1
# Numbers of images, so that no two share their noise: backgrounds, presses, then the specimen.
_FIRST_PRESS, _FIRST_TRIAL = 1000, 2000


@dataclass(frozen=True, eq=False)
class ColourSensor:
    """A sensor ready to look at pressed faces.

    Attributes
    ----------
    experiment : Experiment
        With a set exposure.
    background : (row, col, channel) float32
        Radiance of the untouched coat on the pixels that the driver keeps.
    """

    experiment: Experiment
    scene: "ColourScene"
    background: FloatArray

    @property
    def pitch_mm(self) -> float:
        """Width of a pixel of the final image on the coat, mean of both axes, middle of the field.

        The layers raise the coat to sum of thickness / index below their top (paraxial).
        """
        device, camera = image_pinhole(self.experiment), self.experiment.camera
        layers = self.experiment.layers.values()
        raised_mm = sum(layer.thickness_mm * (1.0 - 1.0 / layer.ior) for layer in layers)
        return (camera.pose.standoff_mm - raised_mm) * (1 / device.fx_px + 1 / device.fy_px) / 2

    def radiance(self, face: "trimesh.Trimesh") -> FloatArray:
        """Return the radiance of a pressed face, (row, col, channel)."""
        self.scene.put(face)
        return self.scene.render(*self._pose(cropped_pinhole(self.experiment)))

    def image(self, face: "trimesh.Trimesh", number: int) -> Levels:
        """Return what the driver delivers of a pressed face, with the noise of image `number`."""
        return develop(self.experiment, self.radiance(face), number)

    def backgrounds(self) -> Levels:
        """Return untouched images, (frame, row, col, 3)."""
        count = self.experiment.photometric.presses.backgrounds
        return np.stack([develop(self.experiment, self.background, n) for n in range(count)])

    def truth(self, face: "trimesh.Trimesh") -> Truth:
        """Return the truth behind the final image; lit is the part that is evaluated."""
        self.scene.put(face)
        return self.scene.truth(*self._pose(image_pinhole(self.experiment)))

    def _pose(self, pinhole: Pinhole) -> tuple[Pinhole, Doubles]:
        return pinhole, world_from_device(self.experiment.camera.pose, pinhole)


@dataclass(frozen=True, eq=False)
class PhotometricMeasurement:
    """One virtual measurement by photometric stereo, whole.

    Attributes
    ----------
    calibrations : dict
        One per colour map, on the same reference images.
    decoded : list of Decoded
        The image by every decoder.
    own : Decoded
        That of the experiment's own decoder.
    """

    pressed: PressedElastomer
    image: Levels
    calibrations: dict[MapKind, SensorCalibration]
    decoded: list[Decoded]
    own: Decoded
    truth: Truth
    seconds: dict[str, float]

    @property
    def calibration(self) -> SensorCalibration:
        """Calibration of the experiment's own colour map."""
        return self.calibrations[self.own.colour_map]

    @property
    def heights(self) -> HeightMap:
        """Heights by the experiment's own decoder."""
        return self.own.heights

    @property
    def score(self) -> PhotometricScore:
        """Score of the experiment's own decoder."""
        return self.own.score


def sensor_of(experiment: Experiment) -> ColourSensor:
    """Build the sensor and look at its untouched coat.

    Raises
    ------
    InputError
        No lamps; or a pose, lens or exposure that this method does not take.
    MissingBackend
        No usable Dr.Jit backend.
    """
    check_sensor(experiment)
    activate()
    from twin.optics.colour_trace import ColourScene

    flat = face_mesh(_untouched(experiment))
    scene = ColourScene(experiment, flat)
    pinhole = cropped_pinhole(experiment)
    background = scene.render(pinhole, world_from_device(experiment.camera.pose, pinhole))
    return ColourSensor(with_fixed_exposure(experiment, background), scene, background)


def reference_images(experiment: Experiment, sensor: ColourSensor) -> list[BallPress]:
    """Press, render and develop the reference balls."""
    found = []
    for number, case in enumerate(ball_presses(experiment)):
        assert isinstance(case.specimen, Ball)
        image = sensor.image(face_mesh(press_specimen(case)), _FIRST_PRESS + number)
        found.append(BallPress(image, case.specimen.diameter_mm))
    return found


def calibrated_sensor(experiment: Experiment) -> tuple[ColourSensor, SensorCalibration]:
    """Return the sensor and its calibration on rendered presses of reference balls.

    Both are kept in memory for further specimens under the same sensor.

    Raises
    ------
    FitError
        A press without a contact circle, or too few presses.
    InputError, MissingBackend
        As `sensor_of`.
    """
    sensor, calibrations = sensor_with_maps(experiment)
    return sensor, calibrations[experiment.photometric.colour_map]


def sensor_with_maps(
    experiment: Experiment,
) -> tuple[ColourSensor, dict[MapKind, SensorCalibration]]:
    """Return the sensor and one calibration per colour map, all on the same reference images.

    Raises
    ------
    FitError
        A press without a contact circle, or too few presses.
    InputError, MissingBackend
        As `sensor_of`.
    """
    rig = with_ball(experiment, Ball(), 0.5).model_dump(mode="json", exclude={"provenance"})
    # Left out is what the reference images do not depend on.
    rig |= {"name": "rig", "description": "", "score": {"roi_radius_mm": 1.0}}
    for other in ("stage", "decode"):
        rig.pop(other)
    for later in ("colour_map", "integration"):
        rig["photometric"].pop(later)
    photographed = _photographed(json.dumps(rig, sort_keys=True))
    return photographed.sensor, {kind: _calibrated(photographed, kind) for kind in MAP_ORDER}


@dataclass(frozen=True, eq=False)
class _Photographed:
    """A sensor with the images that it is calibrated on."""

    sensor: ColourSensor
    backgrounds: Levels
    presses: tuple[BallPress, ...]


@lru_cache(maxsize=2)
def _photographed(rig: str) -> _Photographed:
    experiment = Experiment.model_validate(json.loads(rig))
    sensor = sensor_of(experiment)
    presses = reference_images(experiment, sensor)
    return _Photographed(sensor, sensor.backgrounds(), tuple(presses))


@lru_cache(maxsize=4)
def _calibrated(images: _Photographed, kind: MapKind) -> SensorCalibration:
    markers = images.sensor.experiment.photometric.markers
    return calibrate_sensor(
        images.presses,
        images.backgrounds,
        images.sensor.pitch_mm,
        kind,
        SampleOptions(
            marker_level=0 if markers is None else MARKER_LEVEL,
            unreadable_share=UNREADABLE_SHARE,
        ),
    )


def measure_photometric(
    experiment: Experiment, watch: Watcher = nobody, trial: int = 0
) -> PhotometricMeasurement:
    """Run one virtual measurement by photometric stereo.

    Parameters
    ----------
    experiment : Experiment
    watch : Watcher
    trial : int
        Repetition with new temporal noise.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    clock = Stopwatch(watch)
    check_sensor(experiment)
    with clock.stage("press"):
        pressed = press_specimen(experiment)
    with clock.stage("calibrate"):
        sensor, calibrations = sensor_with_maps(experiment)
    with clock.stage("render"):
        face = face_mesh(pressed)
        image, truth = sensor.image(face, _FIRST_TRIAL + trial), sensor.truth(face)
    with clock.stage("reconstruct"):
        decoded = decode_all(experiment, image, calibrations, truth)
    return PhotometricMeasurement(
        pressed, image, calibrations, decoded, chosen(experiment, decoded), truth, clock.seconds
    )


def check_sensor(experiment: Experiment) -> None:
    """Refuse a rig that is no sensor for photometric stereo.

    Raises
    ------
    InputError
        No lamps, a camera that leans, or depth of field.
    """
    if not experiment.lamps:
        raise InputError("lamps: found none; photometric stereo needs [lamps.NAME] beside the gel")
    camera = experiment.camera
    if camera.pose.polar_deg or camera.pose.roll_deg:
        raise InputError(
            "camera.pose: photometric stereo maps pixels to mm by one pitch; set polar_deg and"
            " roll_deg to 0"
        )
    if camera.depth_of_field:
        raise InputError("camera.depth_of_field: not rendered for photometric stereo; set it false")


def _untouched(experiment: Experiment) -> PressedElastomer:
    """Return the untouched coat on the nodes of a pressed one: a press, its relief taken off."""
    case = with_ball(experiment, Ball(diameter_mm=8.0), 0.2)
    pressed = press_smooth(case)
    flat, free = np.zeros_like(pressed.face_z_mm), np.zeros_like(pressed.pressure_kpa)
    return with_texture(case, replace(pressed, face_z_mm=flat, pressure_kpa=free))

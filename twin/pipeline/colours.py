"""Run a virtual measurement by photometric stereo: coloured lamps light the coat behind its gel.

One sensor records all presses: reference balls, from which the map from colour to slope is
calibrated, the undeformed gel, and the specimen. All presses are computed, rendered and converted
to images by the same functions. The stages sensor -> references -> calibrations are computed once
for all specimens under the same sensor.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Levels
from reconstruction.colour_maps import COLOUR_MAPS, maps_in_order
from reconstruction.errors import InputError
from reconstruction.photometric import (
    BallPress,
    RestSurface,
    SensorCalibration,
    calibrate_sensor,
)
from reconstruction.photometric.calibration_ball import SampleOptions
from reconstruction.photometric.images import mean_background
from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment, digest, seed_sequence
from twin.config.layers import raised_mm
from twin.mechanics import PressedElastomer
from twin.optics.backed_coat import seen_face
from twin.optics.lamps import drifted_flux
from twin.optics.rig import world_from_device
from twin.optics.session import renderer_session
from twin.optics.stack import Truth
from twin.output import versions
from twin.pipeline.colour_images import (
    cropped_pinhole,
    develop,
    fixed_exposure_ms,
    image_pinhole,
)
from twin.pipeline.fringes import RunContext
from twin.pipeline.kept_calibrations import KeptCalibrations
from twin.pipeline.memory import CachedResult, Memory
from twin.pipeline.press import press, press_smooth, with_texture
from twin.pipeline.reference_presses import (
    ball_presses,
    bare_face,
    rest_surface,
    undeformed,
)
from twin.results.colours import decode_colours
from twin.results.figures import Metric, warnings_of
from twin.results.parts import press_metrics
from twin.results.printed_dots import sensor_dots
from twin.results.record import Colours, Measurement
from twin.results.score import metrics
from twin.specimens.kinds.ball import Ball

if TYPE_CHECKING:
    import trimesh

    from twin.optics.colour_trace import ColourScene

# Largest grey level of a printed dot (measured behaviour of the vendor's programs).
MARKER_LEVEL = 70
# Share of reference presses that may show no contact circle, as a small ball in a dark corner. With
# a real sensor the user would repeat such a press.
UNREADABLE_SHARE = 0.1
# First numbers of the images, which select their noise: backgrounds from 0, reference presses,
# specimen.
_FIRST_PRESS, _FIRST_TRIAL = 1000, 2000


@dataclass(frozen=True, eq=False)
class LitCoat:
    """Loaded scene of the coat under its lamps, with the radiance of the undeformed coat.

    Attributes
    ----------
    scene : scene into which pressed faces are put
    background : (row, col, channel) float32
        Radiance of the undeformed coat on the pixels of `cropped_pinhole`, mW / (mm^2 sr).
    exposure_ms : exposure time of all images, determined from the background
    rest : undeformed coat of a domed gel at the pixels of the final image; None: it is flat
    """

    scene: "ColourScene"
    background: FloatImage
    exposure_ms: float
    rest: RestSurface | None = None


@dataclass(frozen=True, eq=False)
class ColourSensor:
    """Simulated photometric sensor with a fixed exposure time, which images pressed faces.

    Attributes
    ----------
    experiment : experiment with the exposure time of `coat` in its camera
    coat : loaded scene of the coat
    """

    experiment: Experiment
    coat: LitCoat

    @classmethod
    def of(cls, experiment: Experiment, coat: LitCoat) -> "ColourSensor":
        """Return the sensor of an experiment, with the exposure time of its lit coat."""
        camera = experiment.camera.model_copy(update={"exposure_ms": coat.exposure_ms})
        return cls(experiment.model_copy(update={"camera": camera}), coat)

    @property
    def pitch_mm(self) -> float:
        """Width on the coat, mm, of a pixel of the final image, in the middle of the field.

        It is the mean of both axes. Seen through the layers, the coat appears at the depth
        sum of (thickness / refractive index) below their top (paraxial).
        """
        device, standoff_mm = (
            image_pinhole(self.experiment),
            self.experiment.camera.pose.standoff_mm,
        )
        distance_mm = standoff_mm - raised_mm(self.experiment.layers)
        return distance_mm * (1 / device.fx_px + 1 / device.fy_px) / 2

    @renderer_session()  # prevents that another thread puts a face into the scene meanwhile
    def image(self, face: "trimesh.Trimesh", number: int) -> Levels:
        """Return the image of a pressed face as the camera's driver outputs it, with noise.

        `number` selects the noise and the drift of the lamps, which differ between presses. The
        background images have no drift: their lamps have the stated flux.
        """
        self.coat.scene.put(face)
        rng = np.random.default_rng(seed_sequence(self.experiment, "lamp_drift", number))
        flux = drifted_flux(self.experiment.lamps, rng)
        radiance = self.coat.scene.render(*self._pose(cropped_pinhole(self.experiment)), flux)
        return develop(self.experiment, radiance, number)

    def backgrounds(self) -> Levels:
        """Return images (frame, row, col, 3) uint8 of the undeformed gel.

        If the experiment requests a truncated background, the only frame is their mean, rounded
        down.
        """
        plan, untouched = self.experiment.photometric.presses, self.coat.background
        frames = np.stack([develop(self.experiment, untouched, n) for n in range(plan.backgrounds)])
        if not plan.truncated_background:
            return frames
        whole: Levels = np.floor(frames.mean(axis=0, dtype=np.float64)).astype(np.uint8)
        return whole[np.newaxis]

    @renderer_session()
    def truth(self, face: "trimesh.Trimesh") -> Truth:
        """Return the true surface at the pixels of the final image.

        The field `lit` marks the pixels that are evaluated.
        """
        self.coat.scene.put(face)
        return self.coat.scene.truth(*self._pose(image_pinhole(self.experiment)))

    @renderer_session()
    def albedo(self, face: "trimesh.Trimesh") -> FloatImage:
        """Return the albedo (row, col) of the coat at the pixels of the final image."""
        self.coat.scene.put(face)
        return self.coat.scene.albedo(*self._pose(image_pinhole(self.experiment)))

    def _pose(self, pinhole: Pinhole) -> tuple[Pinhole, FloatArray]:
        return pinhole, world_from_device(self.experiment.camera.pose, pinhole)


@dataclass(frozen=True, eq=False)
class References:
    """Images on which a sensor is calibrated: backgrounds, and presses of reference balls.

    backgrounds are (frame, row, col, 3) uint8 images of the undeformed gel.
    """

    backgrounds: Levels
    presses: tuple[BallPress, ...]


def measure_colours(experiment: Experiment, run: RunContext) -> Measurement:
    """Run one virtual measurement by photometric stereo.

    Raises
    ------
    InputError, MissingBackend : for the reasons of `twin.pipeline.measure`
    """
    memory, clock = run.memory, run.clock
    check_sensor(experiment)
    with clock.stage("press") as progress:
        pressed = press(experiment, memory, progress)
    with clock.stage("calibrate"):
        coat, calibrations = _calibrated(experiment, memory)
    with clock.stage("render"):
        images = memory.recall(
            "image",
            experiment,
            (coat.token, pressed.face_digest, run.trial),
            lambda images: _photograph(images, coat.value, pressed.pressed, run.trial),
        )
    image, truth = images.value
    with clock.stage("reconstruct"):
        colours = decode_colours(experiment, image, calibrations, truth, pressed.pressed)
    done = Measurement(
        experiment=experiment,
        images=colours,
        truth=truth,
        score=colours.own.score,
        metrics=_metrics(pressed.pressed, colours),
        pressed=pressed.pressed,
        digest=digest(experiment),
        versions=versions(),
        seconds=clock.seconds,
    )
    with clock.stage("object"):
        return done.with_object()


def _metrics(pressed: PressedElastomer, colours: Colours) -> dict[str, Metric]:
    figures = press_metrics(pressed) | dict(metrics(colours.own.score))
    if colours.dots is None:
        return figures
    warnings = [*warnings_of(figures), *colours.dots.warnings]
    return figures | colours.dots.figures | {"warnings": warnings}


def calibrated_sensor(
    experiment: Experiment, memory: Memory | None = None
) -> tuple[ColourSensor, SensorCalibration]:
    """Return the simulated sensor of an experiment, calibrated on rendered presses of balls.

    Parameters
    ----------
    memory : cache of stage results; None: no cache

    Raises
    ------
    FitError : too many presses have no contact circle, or there are too few presses
    InputError : the experiment has no lamps, or a camera pose, lens or exposure that is not allowed
    MissingBackend : there is no usable Dr.Jit backend
    """
    check_sensor(experiment)
    coat, calibrations = _calibrated(experiment, memory or Memory())
    sensor = ColourSensor.of(experiment, coat.value)
    return sensor, calibrations[experiment.photometric.colour_map]


def coat_albedo(experiment: Experiment, pressed: PressedElastomer, memory: Memory) -> FloatImage:
    """Return the albedo (row, col) of a pressed coat at the pixels of the final image.

    Raises
    ------
    InputError, MissingBackend : for the reasons of `calibrated_sensor`
    """
    check_sensor(experiment)
    coat = memory.recall("sensor", experiment, (), _lit_coat).value
    return ColourSensor.of(experiment, coat).albedo(seen_face(experiment, pressed))


def check_sensor(experiment: Experiment) -> None:
    """Check that the rig of an experiment is a sensor for photometric stereo.

    Raises
    ------
    InputError : the rig has no lamps, its camera is not perpendicular to the coat, or has a finite
        depth of field
    """
    if not experiment.lamps:
        raise InputError("lamps: found none; photometric stereo needs [lamps.NAME] around the gel")
    camera = experiment.camera
    if camera.pose.polar_deg or camera.pose.roll_deg:
        raise InputError(
            "camera.pose: photometric stereo maps pixels to mm by one pitch; set polar_deg and"
            " roll_deg to 0"
        )
    if camera.depth_of_field:
        raise InputError("camera.depth_of_field: not rendered for photometric stereo; set it false")


def _calibrated(
    experiment: Experiment, memory: Memory
) -> tuple[CachedResult[LitCoat], dict[str, SensorCalibration]]:
    """Return the lit coat, and one calibration per kind of colour map.

    All calibrations are fitted to the same reference images. They are read from the folder of
    stored calibrations if it has them.
    """
    coat = memory.recall("sensor", experiment, (), _lit_coat)
    store = None if memory.calibrations is None else KeptCalibrations(memory.calibrations)
    stored = None if store is None else store.find(experiment)
    if stored is not None:
        return coat, stored
    references = memory.recall(
        "references",
        experiment,
        coat.token,
        lambda watched: _references(ColourSensor.of(watched, coat.value)),
    )
    calibrations = memory.recall(
        "calibrations",
        experiment,
        (references.token, COLOUR_MAPS.names()),
        lambda watched: _calibrations(ColourSensor.of(watched, coat.value), references.value),
    )
    if store is not None:
        store.put([coat.reads, references.reads, calibrations.reads], calibrations.value)
    return coat, calibrations.value


@renderer_session()
def _lit_coat(experiment: Experiment) -> LitCoat:
    from twin.optics.colour_trace import ColourScene

    coat = undeformed(experiment)
    scene = ColourScene(experiment, bare_face(experiment, coat))
    pinhole = cropped_pinhole(experiment)
    background = scene.render(pinhole, world_from_device(experiment.camera.pose, pinhole))
    rest = rest_surface(experiment, scene, coat) if coat.face_z_mm.any() else None
    return LitCoat(scene, background, fixed_exposure_ms(experiment, background), rest)


def _references(sensor: ColourSensor) -> References:
    """Return the images of the pressed reference balls and of the undeformed gel."""
    references, backgrounds = [], sensor.backgrounds()
    smoothing_px = SampleOptions().smoothing_px
    dots = sensor_dots(sensor.experiment, mean_background(backgrounds), smoothing_px)
    for number, case in enumerate(ball_presses(sensor.experiment)):
        assert isinstance(case.specimen, Ball)
        pressed = with_texture(case, press_smooth(case))
        image = sensor.image(seen_face(case, pressed), _FIRST_PRESS + number)
        hidden = None if dots is None else dots.covered(image)
        references.append(BallPress(image, case.specimen.diameter_mm, hidden))
    return References(backgrounds, tuple(references))


def _calibrations(sensor: ColourSensor, references: References) -> dict[str, SensorCalibration]:
    markers = sensor.experiment.photometric.markers
    options = SampleOptions(
        marker_level=0 if markers is None else MARKER_LEVEL, unreadable_share=UNREADABLE_SHARE
    )
    images = references.presses, references.backgrounds
    return {
        kind.name: calibrate_sensor(
            *images, sensor.pitch_mm, kind.name, options, rest=sensor.coat.rest
        )
        for kind in maps_in_order()
    }


def _photograph(
    experiment: Experiment, coat: LitCoat, pressed: PressedElastomer, trial: int
) -> tuple[Levels, Truth]:
    sensor, face = ColourSensor.of(experiment, coat), seen_face(experiment, pressed)
    return sensor.image(face, _FIRST_TRIAL + trial), sensor.truth(face)

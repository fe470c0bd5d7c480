"""Make the twin of a real rig: from captures and their calibration to the fields of a rig file.

Fields that the captures do not determine have the value of the model rig, and their source starts
with `assumed`. The table in `twin.adoption.fields` lists the data from which each field is
estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.capture.folder import Capture, read_capture
from reconstruction.characterise import (
    PhotonTransfer,
    ProjectorFit,
    Sparkle,
    UncertainValue,
    sparkle_of,
)
from reconstruction.errors import InputError, counted
from reconstruction.pipeline import Reconstruction, ReconstructOptions, reconstruct
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise
from twin.adoption.capture_fits import (
    dark_frames,
    fit_captures,
    noise_of,
    two_period_chi2,
    with_black,
)
from twin.adoption.defocus import defocus_fields, defocus_of
from twin.adoption.elastomer import KnownBallPress, elastomer_fields, press_capture
from twin.adoption.fields import (
    camera_fields,
    flat_fields,
    level_field,
    light_fields,
    pattern_fields,
    pose_fields,
    response_of,
)
from twin.adoption.findings import ModelRig, RigField, rig_tables, validated
from twin.adoption.poses import Placed, place
from twin.adoption.rendered import Scene, albedo_of
from twin.config.models import Experiment
from twin.pipeline.progress import ProgressCallback, no_progress

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


@dataclass(frozen=True)
class Given:
    """Inputs of `adopt`.

    Attributes
    ----------
    captures : folders of captures, at least one
    model : model rig; its values are used for all fields that the captures do not determine
    dark, flat : folders of images without light, and of an evenly lit surface; None: no images
    reference : capture of a flat matte surface in the coat's place, at the same exposure; None: the
        coat's albedo is not determined
    reference_albedo : albedo of that surface, with its standard uncertainty
    press : press of a known ball into the sheet; None: the elastomer is not determined
    """

    captures: tuple[Path, ...]
    model: str = "rigs/slab"
    dark: Path | None = None
    flat: Path | None = None
    reference: Path | None = None
    reference_albedo: UncertainValue | None = None
    press: KnownBallPress | None = None

    def __post_init__(self) -> None:
        if not self.captures:
            raise InputError("adopt: found no capture; give at least one folder with capture.toml")
        if (self.reference is None) != (self.reference_albedo is None):
            raise InputError("adopt: --reference and --reference-albedo go together; give both")


@dataclass(frozen=True, eq=False)
class Adopted:
    """An adopted rig and the intermediate results of its adoption.

    Attributes
    ----------
    fields : fields that the captures determine or state, by dotted path
    tables : all tables of the rig file
    experiment : an experiment with the adopted rig
    capture, points : the first capture with the estimated noise and response, and its
        reconstruction
    fit : fitted projector response of the first capture that could be fitted; None: no such capture
    noise : camera noise; None: not determined
    noise_from : method by which the camera noise was estimated, as text
    placed : poses and lenses of camera and projector
    stated : camera noise according to capture.toml
    two_period_chi2 : chi-square per pixel of two captures with different periods; None: not
        determined
    sparkle : local contrast of the coat in the white frame; None: not determined
    notes : remarks for the user, one line each
    """

    fields: dict[str, RigField]
    tables: dict[str, object]
    experiment: Experiment
    capture: Capture
    points: Reconstruction
    fit: ProjectorFit | None
    noise: PhotonTransfer | None
    noise_from: str
    placed: Placed
    stated: SensorNoise
    two_period_chi2: float | None
    sparkle: Sparkle | None
    notes: tuple[str, ...] = field(default=())

    def __repr__(self) -> str:
        measured = sum(entry.source.startswith("measured") for entry in self.fields.values())
        notes = counted(len(self.notes), "note")
        return f"<Adopted: {len(self.fields)} fields, {measured} measured, {notes}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        rows = {path: f"{entry.value} ({entry.source})" for path, entry in self.fields.items()}
        return as_html("twin of a real rig; units in the names", rows, self.plot())

    def plot(self) -> "Drawing":
        """Draw the reconstruction of the first capture with this rig, as a Matplotlib figure.

        Raises
        ------
        InputError : no pixel has a point
        """
        return self.points.plot()

    def to_xarray(self) -> "xarray.Dataset":
        """Return the maps of the reconstruction of the first capture over camera row and column."""
        return self.points.to_xarray()


def adopt(given: Given, watch: ProgressCallback = no_progress) -> Adopted:
    """Return the rig that the captures determine, with the intermediate results.

    `watch` is called with the name of each stage and its finished fraction.

    Raises
    ------
    InputError : a capture cannot be read, or is of another rig than the first capture
    """
    model, notes = ModelRig.read(given.model), list[str]()
    watch("read", 0.0)
    captures = [read_capture(folder) for folder in given.captures]
    _require_alike(given.captures, captures)
    watch("read", 1.0)
    dark = dark_frames(given.dark, captures[0]) if given.dark else None
    sensor = with_black(captures[0].sensor, dark)
    watch("fit", 0.0)
    fitted = fit_captures(given.captures, captures, sensor, notes)
    fits = [fit_of_capture.fit for fit_of_capture in fitted]
    noise, noise_from = noise_of(captures, fits, sensor, notes)
    placed = place(captures[0].calibration, captures[0].patterns.pixel_ratio)
    watch("fit", 1.0)
    fields = camera_fields(captures[0], model, noise, noise_from, dark)
    fields |= pose_fields(captures[0], model, placed, notes)
    if given.flat is not None:
        fields |= flat_fields(given.flat, captures[0], sensor, dark)
    fields |= light_fields(fits, dark) | pattern_fields(captures[0])
    defocus = defocus_of([fit_of_capture.blur for fit_of_capture in fitted])
    if defocus is not None:
        focal_px = captures[0].calibration.projector.fx_px
        fields |= defocus_fields(defocus, focal_px, len(fitted))
    known = _known(captures[0], sensor, noise, response_of(fields, fits))
    points = reconstruct(known, ReconstructOptions())
    fields |= level_field(known)
    scene = Scene(known, points, placed.origin_mm)
    fields |= _albedo_field(given, scene, validated(rig_tables(model, fields)), watch)
    fields |= _press_fields(given, known, watch)
    tables = rig_tables(model, fields)
    return Adopted(
        fields=fields,
        tables=tables,
        experiment=validated(tables),
        capture=known,
        points=points,
        fit=fits[0] if fits else None,
        noise=noise,
        noise_from=noise_from,
        placed=placed,
        stated=captures[0].sensor,
        two_period_chi2=two_period_chi2(captures, known),
        sparkle=coat_sparkle(known, points),
        notes=tuple(notes),
    )


def adopt_rig(
    *captures: Path | str,
    model: str = "rigs/slab",
    dark: Path | str | None = None,
    flat: Path | str | None = None,
    reference: Path | str | None = None,
    reference_albedo: UncertainValue | None = None,
    press: KnownBallPress | None = None,
    watch: ProgressCallback = no_progress,
) -> Adopted:
    """Make the twin of a real rig from its captures, as the command `twin adopt` does.

    Parameters
    ----------
    captures : folders with capture.toml, calibration and white and black frames; at least one
    model : model rig; its values are used for all fields that the captures do not determine
    dark, flat : folders of images without light, and of an evenly lit surface; None: no images
    reference : capture of a flat matte surface in the coat's place, at the same exposure; None: the
        coat's albedo is not determined
    reference_albedo : albedo of that surface, with its standard uncertainty
    press : press of a known ball into the sheet; None: the elastomer is not determined
    watch : called with the name of each stage and its finished fraction

    Raises
    ------
    InputError : a capture cannot be read, or is of another rig than the first capture
    """
    given = Given(
        captures=tuple(map(Path, captures)),
        model=model,
        dark=None if dark is None else Path(dark),
        flat=None if flat is None else Path(flat),
        reference=None if reference is None else Path(reference),
        reference_albedo=reference_albedo,
        press=press,
    )
    return adopt(given, watch)


def _albedo_field(
    given: Given, scene: Scene, experiment: Experiment, watch: ProgressCallback
) -> dict[str, RigField]:
    """Return the field of the coat's albedo by path; empty if no reference is given."""
    if given.reference is None or given.reference_albedo is None:
        return {}
    watch("render", 0.0)
    reference, known = read_capture(given.reference), scene.capture
    _require_alike((given.captures[0], given.reference), (known, reference))
    calibrated = replace(reference, sensor=known.sensor, response=known.response)
    albedo = albedo_of(experiment, scene, calibrated, given.reference_albedo)
    known_albedo = given.reference_albedo.value
    how = f"white frames beside those of {given.reference.name}, albedo {known_albedo:g}"
    watch("render", 1.0)
    entry = RigField.measured(f"coating.{experiment.coating.albedo_field}", albedo, how)
    return {entry.path: entry}


def _press_fields(given: Given, known: Capture, watch: ProgressCallback) -> dict[str, RigField]:
    """Return the fields of the elastomer by path; empty if no press of a known ball is given."""
    if given.press is None:
        return {}
    watch("press", 0.0)
    pressed = press_capture(given.press, known)
    _require_alike((given.captures[0], given.press.capture), (known, pressed))
    fields = elastomer_fields(given.press, pressed)
    watch("press", 1.0)
    return fields


def _require_alike(folders: Sequence[Path], captures: Sequence[Capture]) -> None:
    first = captures[0]
    for folder, capture in zip(folders, captures, strict=True):
        if capture.stack.shape[1:] != first.stack.shape[1:] or capture.bit_depth != first.bit_depth:
            raise InputError(
                f"{folder}: has {capture.stack.shape[2]} x {capture.stack.shape[1]} pixels of "
                f"{capture.bit_depth} bits, {folders[0]} has {first.stack.shape[2]} x "
                f"{first.stack.shape[1]} of {first.bit_depth}; adopt captures of one rig"
            )
        motion = capture.calibration.T_world_from_cam
        if not np.allclose(motion, first.calibration.T_world_from_cam, atol=1e-6):
            raise InputError(
                f"{folder}: has another calibration than {folders[0]}; adopt captures of one rig"
            )


def _known(
    capture: Capture,
    sensor: SensorNoise,
    noise: PhotonTransfer | None,
    response: ProjectorResponse | None,
) -> Capture:
    """Return the capture with the estimated camera noise and projector response.

    Without an estimate (None), the noise is `sensor` and the response that of the capture.
    """
    if noise is not None:
        read_e = noise.read_noise_e.value if noise.read_noise_e else 0.0
        sensor = replace(sensor, gain_dn_per_e=noise.gain_dn_per_e.value, read_noise_e=read_e)
    return replace(capture, sensor=sensor, response=response or capture.response)


def coat_sparkle(capture: Capture, points: Reconstruction) -> Sparkle | None:
    """Return the coat's local contrast in the white frame.

    The result is None if the capture has no white frame or too few pixels with a point.
    """
    if not capture.patterns.uniform:
        return None
    white = capture.stack[capture.patterns.index("white").start]
    try:
        return sparkle_of(white, capture.sensor, points.point_map.valid)
    except InputError:
        return None

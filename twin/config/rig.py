"""Keys of camera and projector that follow from the table [optics] of an experiment.

The keys of the camera are those of `twin.config.camera_rig`. `angle_deg` or `baseline_mm` determine
projector.pose.polar_deg: the projector keeps its distance and its azimuth.
"""

import math
from collections.abc import Mapping

from pydantic import ValidationError

from reconstruction.errors import InputError
from reconstruction.reading import read_toml
from twin.assets import asset_path, list_assets
from twin.config import imaging
from twin.config.base import ConfigError
from twin.config.camera_rig import (
    Derived,
    LensError,
    UnmetError,
    Values,
    camera_keys,
    number_at,
    sensor_of,
)
from twin.config.imaging import SensorArea
from twin.config.optics import FixedFocal, Optics, Telecentric
from twin.config.quantities import split_quantities

LENSES = "lenses/"
_MOST_NAMED = 3


def derived_keys(values: Values, where: str) -> dict[str, Derived]:
    """Return the keys that follow from [optics], by dotted path; empty without this table.

    Invalid or missing numbers are skipped: the validation of the experiment reports them.

    Parameters
    ----------
    values : nested tables with plain values
    where : start of the message, for example the name of the file

    Raises
    ------
    ConfigError : a request cannot be met; one line with the remedy, and the lenses that meet it
    """
    optics, sensor = _optics(values), sensor_of(values)
    if optics is None or not optics.is_stated:
        return {}
    try:
        camera = {} if sensor is None else camera_keys(optics, sensor, values)
        return camera | _projector_keys(optics, values, camera)
    except UnmetError as error:
        try_lens = isinstance(error, LensError) and sensor is not None and optics.lens is not None
        remedy = _alternatives(optics, sensor, values) if try_lens and sensor else ""
        raise ConfigError(f"{where}: optics.{error}{remedy}") from None


def _optics(values: Values) -> Optics | None:
    try:
        return Optics.model_validate(values.get("optics", {}))
    except ValidationError:
        return None


def _projector_keys(
    optics: Optics, values: Values, camera: Mapping[str, Derived]
) -> dict[str, Derived]:
    if optics.angle_deg is None and optics.baseline_mm is None:
        return {}
    angle_deg = _angle(optics, values, camera)
    polar = number_at(values, "camera.pose.polar_deg", 0.0)
    azimuths = [
        number_at(values, f"{name}.pose.azimuth_deg", 0.0) for name in ("camera", "projector")
    ]
    if angle_deg is None or polar is None or None in azimuths:
        return {}
    between_deg = (azimuths[1] or 0.0) - (azimuths[0] or 0.0)
    polar_deg = imaging.polar_of_angle(angle_deg, polar, between_deg)
    if polar_deg is None:
        key = "angle_deg" if optics.angle_deg is not None else "baseline_mm"
        raise UnmetError(
            f"{key}: no projector at azimuth {azimuths[1]:g} above the coat is {angle_deg:.4g} "
            f"degrees from a camera at polar angle {polar:g}, azimuth {azimuths[0]:g}; move the "
            "camera (camera.pose) or use another angle"
        )
    stated = f"angle {optics.angle_deg:g} deg" if optics.angle_deg is not None else ""
    stated = stated or f"baseline {optics.baseline_mm:g} mm"
    return {"projector.pose.polar_deg": Derived(polar_deg, f"derived: {stated} to the camera")}


def _angle(optics: Optics, values: Values, camera: Mapping[str, Derived]) -> float | None:
    """Return the requested angle between the devices, degrees; None if a distance is missing."""
    baseline_mm = optics.baseline_mm
    if baseline_mm is None:
        return optics.angle_deg
    if optics.angle_deg is not None:
        raise UnmetError(
            f"baseline_mm: found {baseline_mm:g} with angle_deg, which determines it; remove one"
        )
    if isinstance(optics.lens, Telecentric):
        raise UnmetError(
            f"baseline_mm: {optics.lens.model} is telecentric, its pupil is at infinity; state "
            "optics.angle_deg"
        )
    derived = camera.get("camera.pose.standoff_mm")
    camera_mm = derived.value if derived else number_at(values, "camera.pose.standoff_mm")
    projector_mm = number_at(values, "projector.pose.standoff_mm")
    if not camera_mm or not projector_mm:
        return None
    angle_deg = imaging.angle_of_baseline(baseline_mm, camera_mm, projector_mm)
    if angle_deg is None:
        raise UnmetError(
            f"baseline_mm: found {baseline_mm:g}, allowed {abs(camera_mm - projector_mm):.4g} to "
            f"{camera_mm + projector_mm:.4g} with camera and projector at {camera_mm:.4g} and "
            f"{projector_mm:.4g} mm; use optics.angle_deg or another projector.pose.standoff_mm"
        )
    return angle_deg


def lenses_meeting(values: Values) -> list[str]:
    """Return the names of the lenses with which the table [optics] of an experiment can be met."""
    optics, sensor = _optics(values), sensor_of(values)
    if optics is None or sensor is None:
        return []
    return _lenses_for(optics, sensor, values)


def shipped_lenses() -> dict[str, FixedFocal | Telecentric]:
    """Return the lenses of scenes/lenses, shipped or the user's own, by the name for `use`."""
    names = (name for name in list_assets("scenes") if name.startswith(LENSES))
    read = ((f"scenes/{name}", _read_lens(name)) for name in names)
    return {name: lens for name, lens in read if lens is not None}


def _read_lens(name: str) -> FixedFocal | Telecentric | None:
    try:
        table, _ = split_quantities(read_toml(asset_path("scenes", name)))
        table.pop("description", None)
        return Optics.model_validate({"lens": table}).lens
    except (InputError, ValidationError):
        return None


def _lenses_for(optics: Optics, sensor: SensorArea, values: Values) -> list[str]:
    """Return the names of the lenses that meet all requests on the camera, smallest field first."""
    magnifications: dict[str, float] = {}
    for name, lens in shipped_lenses().items():
        try:
            keys = camera_keys(optics.model_copy(update={"lens": lens}), sensor, values)
        except UnmetError:
            continue
        if "camera.focal_length_mm" not in keys:
            continue  # no distance is known
        focal_mm = keys["camera.focal_length_mm"].value
        derived = keys.get("camera.pose.standoff_mm")
        at_mm = derived.value if derived else number_at(values, "camera.pose.standoff_mm")
        magnifications[name] = imaging.magnification_at(focal_mm, at_mm or math.inf)
    return sorted(magnifications, key=lambda name: -magnifications[name])


def _alternatives(optics: Optics, sensor: SensorArea, values: Values) -> str:
    """Return the end of a message: the lenses that meet a request, those of smallest field."""
    fitting = ", ".join(_lenses_for(optics, sensor, values)[:_MOST_NAMED])
    return f"; it is met by {fitting}" if fitting else "; no lens of scenes/lenses meets it"

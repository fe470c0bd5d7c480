"""Make the fields of a rig file from estimates of its captures.

| field | estimated from |
|---|---|
| poses, focal lengths, distortion | calibration.yaml (`poses`) |
| full well (from the gain), read noise | photon transfer |
| black level, DSNU | dark frames |
| PRNU | flat frames |
| gamma, blur | the fit of all frames, phase steps and Gray edges |
| contrast | the black frame and dark frames |
| level of the automatic exposure | white frames |
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from reconstruction.arrays import Stack
from reconstruction.capture.folder import Capture
from reconstruction.capture.image_files import read_stack_of_images
from reconstruction.characterise import (
    Dark,
    PhotonTransfer,
    ProjectorFit,
    UncertainValue,
    prnu_of,
)
from reconstruction.errors import InputError
from reconstruction.reading import is_regular
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise
from twin.adoption.findings import ModelRig, RigField
from twin.adoption.poses import Placed
from twin.config.bounds import EXPOSURE_PERCENTILE
from twin.config.models import Patterns

_IMAGES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".npy")
_BIT_DEPTHS = (8, 10, 12, 14, 16)
_BINNINGS = (4, 2, 1)


def read_images(folder: Path, capture: Capture) -> Stack:
    """Return all images (frame, row, col), DN, of a folder of dark or flat frames.

    Raises
    ------
    InputError : the folder has no images, or their size is not that of the capture
    """
    files = sorted(
        path for path in (folder.iterdir() if folder.is_dir() else ())
        if path.suffix.lower() in _IMAGES and is_regular(path)
    )  # fmt: skip
    if not files:
        raise InputError(f"{folder}: found no images; give a folder of {', '.join(_IMAGES)}")
    stack = read_stack_of_images(files, capture.bit_depth)
    if stack.shape[1:] != capture.stack.shape[1:]:
        raise InputError(
            f"{folder}: images have {stack.shape[2]} x {stack.shape[1]} px, the captures "
            f"{capture.stack.shape[2]} x {capture.stack.shape[1]}; record them alike"
        )
    return stack


def _binning(capture: Capture, model: ModelRig) -> int:
    width = capture.stack.shape[2]
    full = model.value("camera.width_px")
    return next((b for b in _BINNINGS if full == width * b), 1)


def camera_fields(
    capture: Capture,
    model: ModelRig,
    noise: PhotonTransfer | None,
    noise_from: str,
    dark: Dark | None,
) -> dict[str, RigField]:
    """Return the camera's fields by path, from the images, their noise and dark frames.

    `noise_from` is the source of the noise as text.
    """
    binning, sensor = _binning(capture, model), capture.sensor
    rows, cols = capture.stack.shape[1:]
    depth = next(bits for bits in _BIT_DEPTHS if bits >= capture.bit_depth)
    stated = "stated: capture.toml"
    fields = [
        RigField("camera.width_px", cols * binning, None, "measured: size of the images"),
        RigField("camera.height_px", rows * binning, None, "measured: size of the images"),
        RigField("camera.binning", binning, None, "assumed: the model's pixels over the images'"),
        RigField("camera.bit_depth", depth, None, stated),
    ]
    black = dark.black_level_dn if dark else None
    fields.append(
        RigField.measured("camera.black_level_dn", black, "dark frames")
        if black
        else RigField("camera.black_level_dn", sensor.black_level_dn, None, stated)
    )
    gain = noise.gain_dn_per_e.value if noise else sensor.gain_dn_per_e
    black_dn = black.value if black else sensor.black_level_dn
    span_dn = float(2**depth - 1) - black_dn
    if noise is not None:
        well = span_dn / (gain * binning**2)
        u = well * noise.gain_dn_per_e.uncertainty / gain
        how = f"{noise_from}; gain {gain:.5g} +- {noise.gain_dn_per_e.uncertainty:.2g} DN/e-"
        fields.append(RigField.measured("camera.full_well_e", UncertainValue(well, u), how))
    if dark is not None and dark.noise_dn is not None and gain > 0.0:
        read = _per_gain(dark.noise_dn, noise, gain * binning)
        fields.append(RigField.measured("camera.read_noise_e", read, "dark frames"))
        dsnu = _per_gain(dark.dsnu_dn, noise, gain * binning)
        fields.append(RigField.measured("camera.dsnu_e", dsnu, "dark frames"))
    elif noise is not None and noise.read_noise_e is not None:
        read_e = noise.read_noise_e
        read_noise = UncertainValue(read_e.value / binning, read_e.uncertainty / binning)
        fields.append(RigField.measured("camera.read_noise_e", read_noise, noise_from))
    return {entry.path: entry for entry in fields}


def _per_gain(
    level_dn: UncertainValue, noise: PhotonTransfer | None, gain: float
) -> UncertainValue:
    relative = 0.0
    if noise is not None:
        relative = noise.gain_dn_per_e.uncertainty / noise.gain_dn_per_e.value
    value = level_dn.value / gain
    return UncertainValue(value, float(np.hypot(level_dn.uncertainty / gain, value * relative)))


def pose_fields(
    capture: Capture, model: ModelRig, placed: Placed, notes: list[str]
) -> dict[str, RigField]:
    """Return the fields of poses and lenses of camera and projector, by path.

    A large misfit of rig and calibration is added to `notes`.
    """
    calibration, binning = capture.calibration, _binning(capture, model)
    camera, projector = calibration.camera, calibration.projector
    pitch_um = float(model.value("camera.pixel_pitch_um"))
    image_mm = placed.camera_focal_px * pitch_um * 1e-3 * binning
    standoff_mm = placed.camera_pose.standoff_mm
    source = (
        f"calibration: the rig misses it by {placed.misfit_px[0]:.2g} px (camera) and "
        f"{placed.misfit_px[1]:.2g} px (projector), RMS"
    )
    if not placed.is_close:
        notes.append(
            f"a rig file fits the calibration to {max(placed.misfit_px):.2g} px only: the rays of "
            "the image centres do not meet in one point, or pixels have another ratio of sides"
        )
    offset = (placed.axis_row_px - (projector.height_px - 1) / 2) / projector.height_px * 200.0
    values: dict[str, object] = {
        "camera.focal_length_mm": image_mm * standoff_mm / (standoff_mm + image_mm),
        "camera.distortion": list(camera.distortion),
        "projector.width_px": projector.width_px,
        "projector.height_px": projector.height_px,
        "projector.throw_ratio": placed.projector_focal_px / projector.width_px,
        "projector.offset_percent": offset,
        "projector.distortion": list(projector.distortion),
    }
    if capture.patterns.pixel_ratio != (model.value("projector.pixel_ratio") or 1.0):
        values["projector.pixel_ratio"] = capture.patterns.pixel_ratio
    for name, pose in (("camera", placed.camera_pose), ("projector", placed.projector_pose)):
        values |= {f"{name}.pose.{key}": value for key, value in pose.model_dump().items()}
    return {path: RigField(path, value, None, source) for path, value in values.items()}


def flat_fields(
    folder: Path, capture: Capture, sensor: SensorNoise, dark: Dark | None
) -> dict[str, RigField]:
    """Return the field of the PRNU by path, estimated from a folder of flat frames."""
    dsnu_dn = dark.dsnu_dn.value if dark else 0.0
    frames = read_images(folder, capture)
    prnu = prnu_of(frames, sensor.black_level_dn, dsnu_dn, sensor.clipped_from_dn)
    percent = UncertainValue(100.0 * prnu.value, 100.0 * prnu.uncertainty)
    entry = RigField.measured(
        "camera.prnu_percent", percent, "flat frames, less their slow changes"
    )
    return {entry.path: entry}


def joint(estimates: Sequence[UncertainValue]) -> UncertainValue:
    """Return the weighted mean of estimates; its uncertainty includes the scatter of the values.

    The uncertainty of the mean is multiplied by Birge's ratio: the square root of chi-square per
    degree of freedom, at least 1. It is at least the smallest given uncertainty, because captures
    of a rig have common systematic errors.
    """
    weight = np.array([1.0 / max(estimate.uncertainty, 1e-9) ** 2 for estimate in estimates])
    value = np.array([estimate.value for estimate in estimates])
    mean = float((weight * value).sum() / weight.sum())
    chi2 = float((weight * (value - mean) ** 2).sum())
    ratio = max(1.0, np.sqrt(chi2 / max(len(estimates) - 1, 1)))
    least = min(estimate.uncertainty for estimate in estimates)
    return UncertainValue(mean, max(float(ratio / np.sqrt(weight.sum())), least))


def light_fields(fits: Sequence[ProjectorFit], dark: Dark | None) -> dict[str, RigField]:
    """Return the fields of gamma, blur and, with dark frames, contrast of the projector, by path.

    The result is empty if no capture was fitted.
    """
    if not fits:
        return {}
    how = f"fit of all frames of {len(fits)} captures; chi-square {fits[0].chi2:.3g} per frame"
    fields = [
        RigField.measured("projector.gamma", joint([fit.gamma for fit in fits]), how),
        RigField.measured("projector.blur_px", joint([fit.blur_px for fit in fits]), how),
    ]
    contrast = _contrast(fits[0], dark) if dark else None
    if contrast is not None:
        source = "black frame less dark frames; ambient light counts as the projector's"
        fields.append(RigField.measured("projector.contrast", contrast, source))
    return {entry.path: entry for entry in fields}


def pattern_fields(capture: Capture) -> dict[str, RigField]:
    """Return the fields of the capture's pattern sequence, by path."""
    shown, stated = capture.patterns, "stated: capture.toml"
    values = Patterns.of(shown).model_dump(mode="json")
    paths = {f"patterns.{name}": value for name, value in values.items() if value != []}
    return {path: RigField(path, value, None, stated) for path, value in paths.items()}


def _contrast(fit: ProjectorFit, dark: Dark) -> UncertainValue | None:
    """Return the light of full white over that of full black.

    The result is None if the black frame is not significantly above the dark level.
    """
    black_dn = fit.offset_dn - dark.black_level_dn.value
    bright = fit.light_dn > np.percentile(fit.light_dn, 20)
    black, light = float(np.mean(black_dn[bright])), float(np.mean(fit.light_dn[bright]))
    scatter = float(np.std(black_dn[bright])) / np.sqrt(float(bright.sum()))
    u = float(np.hypot(scatter, dark.black_level_dn.uncertainty))
    if black < 3.0 * u:
        return None
    return UncertainValue((light + black) / black, (light + black) / black * u / black)


def level_field(capture: Capture) -> dict[str, RigField]:
    """Return the fields of an automatic exposure with the brightness of the white frame, by path.

    The result is empty if the capture has no white frame.
    """
    if not capture.patterns.uniform:
        return {}
    white = capture.stack[capture.patterns.index("white").start].astype(np.float64)
    sensor = capture.sensor
    share = (float(np.percentile(white, EXPOSURE_PERCENTILE)) - sensor.black_level_dn) / (
        sensor.saturation_dn - sensor.black_level_dn
    )
    how = f"measured: {EXPOSURE_PERCENTILE:g}th percentile of the white frame over full scale"
    auto = RigField("camera.exposure_ms", "auto", None, "measured: the images' own level")
    if not 0.0 < share < 1.0:
        return {auto.path: auto}
    level = RigField("camera.auto_level", share, None, how)
    return {level.path: level, auto.path: auto}


def response_of(
    fields: dict[str, RigField], fits: Sequence[ProjectorFit]
) -> ProjectorResponse | None:
    """Return the projector's response in the first capture; None if it was not estimated.

    If a defocus was fitted, the blur of the rig is that at best focus; then the fitted blur of the
    first capture is returned instead.
    """
    gamma = fields.get("projector.gamma")
    if gamma is None or not fits:
        return None
    blur = fields["projector.blur_px"]
    if "projector.aperture_mm" in fields:
        own = fits[0].blur_px
        blur = RigField(blur.path, own.value, own.uncertainty, blur.source)
    return ProjectorResponse(
        gamma.value, gamma.uncertainty or 0.0, blur.value, blur.uncertainty or 0.0
    )

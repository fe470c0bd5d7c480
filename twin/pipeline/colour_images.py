"""Convert the rendered radiance of a colour sensor to the 8-bit image that its driver delivers.

The steps are those of the product, in this order: vignetting of the lens, sensor noise, white
balance, power law, 8 bits, crop, resize. A crop of a pinhole camera is exact, so that only the
cropped area is rendered.
"""

from dataclasses import replace

import cv2
import numpy as np

from reconstruction.arrays import FloatImage, Levels
from reconstruction.rig.pinhole import Pinhole
from twin.camera import choose_exposure_ms, expose, largest_code_dn
from twin.config.lamps import CHANNELS
from twin.config.models import Experiment
from twin.optics.rig import camera_pinhole


def cropped_pinhole(experiment: Experiment) -> Pinhole:
    """Return the pinhole camera of the part of the binned image that remains after the crop."""
    whole, share = camera_pinhole(experiment.camera), experiment.photometric.crop
    left, top = int(whole.width_px * share), int(whole.height_px * share)
    return replace(
        whole,
        width_px=whole.width_px - 2 * left,
        height_px=whole.height_px - 2 * top,
        cx_px=whole.cx_px - left,
        cy_px=whole.cy_px - top,
    )


def image_pinhole(experiment: Experiment) -> Pinhole:
    """Return the pinhole camera of the cropped and resized image; its pixels may not be square."""
    pinhole, size = cropped_pinhole(experiment), experiment.photometric
    x, y = size.width_px / pinhole.width_px, size.height_px / pinhole.height_px
    # The centre of the first pixel is half a pixel inside the image, for any size of the pixels.
    return replace(
        pinhole,
        width_px=size.width_px,
        height_px=size.height_px,
        fx_px=pinhole.fx_px * x,
        fy_px=pinhole.fy_px * y,
        cx_px=(pinhole.cx_px + 0.5) * x - 0.5,
        cy_px=(pinhole.cy_px + 0.5) * y - 0.5,
    )


def fixed_exposure_ms(experiment: Experiment, background: FloatImage) -> float:
    """Return the exposure time, ms, for all images of a sensor.

    An automatic exposure is determined from the brightest channel of the undeformed coat. All
    images have this exposure, because they are compared with the background.

    Parameters
    ----------
    background : (row, col, channel) float32, mW / (mm^2 sr)

    Raises
    ------
    InputError : the exposure is automatic, and no lamp lights the coat
    """
    brightest = light_on_sensor(experiment, background).max(axis=-1)
    return choose_exposure_ms(experiment, brightest)


def light_on_sensor(experiment: Experiment, radiance: FloatImage) -> FloatImage:
    """Return the equivalent radiance (row, col, channel) at the projector's wavelength.

    Its unit is mW / (mm^2 sr). On the axis of the camera it would release as many electrons as
    `radiance` does on its pixel, behind the lens with vignetting. The exposure model is for photons
    of the projector's wavelength, and 1 mW of red has more photons than 1 mW of blue.

    Parameters
    ----------
    radiance : (row, col, channel) float32
        Radiance on the pixels of `cropped_pinhole`, mW / (mm^2 sr).
    """
    reference_nm = experiment.projector.wavelength_nm
    factors = [_wavelength_nm(experiment, channel) / reference_nm for channel in CHANNELS]
    falloff = vignetting(cropped_pinhole(experiment), experiment.photometric.vignetting_exponent)
    return radiance * falloff[..., None] * np.array(factors, np.float32)


def vignetting(pinhole: Pinhole, exponent: float) -> FloatImage:
    """Return the ratio of the illuminance on the sensor to that on the axis, (row, col) float32.

    The ratio is a power of the cosine of the angle to the axis. The exponent is 4 for a lens with
    no stop but its pupil (natural vignetting): cos^2 by the longer distance, cos by the inclination
    of the pupil and cos by that of the sensor.
    """
    x = (np.arange(pinhole.width_px) - pinhole.cx_px) / pinhole.fx_px
    y = (np.arange(pinhole.height_px) - pinhole.cy_px) / pinhole.fy_px
    falloff: FloatImage = ((1.0 + x**2 + y[:, None] ** 2) ** (-exponent / 2.0)).astype(np.float32)
    return falloff


def develop(experiment: Experiment, radiance: FloatImage, trial: int = 0) -> Levels:
    """Expose the camera, and return the image that its driver delivers.

    Parameters
    ----------
    experiment : experiment with a fixed exposure time
    radiance : (row, col, channel) float32, mW / (mm^2 sr)
        Radiance on the pixels of `cropped_pinhole`.
    trial : number of the image, which selects the temporal noise

    Returns
    -------
    (row, col, 3) uint8, red first, after crop and resize
    """
    camera, size = experiment.camera, experiment.photometric
    channels = list(np.moveaxis(light_on_sensor(experiment, radiance), -1, 0))
    exposed = expose(experiment, channels, white_frame=0, trial=trial)
    black_dn = camera.black_level_dn
    dn = np.moveaxis(exposed.stack, 0, -1).astype(np.float32)
    balance = size.white_balance
    gains = np.array([getattr(balance, channel) for channel in CHANNELS], np.float32)
    linear = np.clip(gains * (dn - black_dn) / (largest_code_dn(camera) - black_dn), 0.0, 1.0)
    levels = np.rint(255.0 * linear ** (1.0 / size.gamma)).astype(np.uint8)
    final = (size.width_px, size.height_px)
    image: Levels = cv2.resize(levels, final, interpolation=cv2.INTER_AREA)
    return image


def _wavelength_nm(experiment: Experiment, channel: str) -> float:
    """Return the mean wavelength, nm, of the lamps of a colour channel, weighted by their flux."""
    lamps = [lamp for lamp in experiment.lamps.values() if lamp.channel == channel]
    weights = [lamp.flux_mw for lamp in lamps]
    return float(np.average([lamp.wavelength_nm for lamp in lamps], weights=weights))

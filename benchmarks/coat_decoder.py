"""Error of the decoder on a coat with flakes that glint, by brute force, without a renderer.

Flakes are discs at random places of a tilted plane, on a grid five times as fine as the pixels.
Their normals are distributed about the coat's; a flake is bright if its normal is near the one that
reflects the projector into the camera. A pixel sums light and fringe over its footprint, i.e. its
area blurred by the lens. All frames of the sequence are computed from these sums.

The last line of the output is one JSON object. Errors are RMS of the height, um, with the paper's
rig: 25 degrees, 14.8 um per camera pixel, 170 um per projector pixel.

glint_error_um_weighted, glint_error_um_robust: frames without camera noise, phase filtered with the
    weights "modulation" and "equal". mae_over_rmse: mean over RMS of the error by "modulation".
glint_error_um_capped, glint_error_um_capped_at_three: the same with weights up to the median of the
    modulation over 9 x 9 pixels, and up to three times this median.
noisy_um_weighted, noisy_um_robust: with camera noise. robust_normalised: error over sigma, RMS.
plain_noise_ratio: noise of "equal" over that of "modulation" on a coat without flakes.
unmasked_wrong, masked_share: number of valid pixels with an error of more than half a period, and
    share of the masked pixels, with glints that saturate.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter
from scipy.signal import fftconvolve

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.decoding import AxisDecode, DecodeOptions, Weights
from reconstruction.decoding._filter import gaussian_weights
from reconstruction.decoding.by_modulation import filter_phase
from reconstruction.decoding.decode import Decoded, decode
from reconstruction.evaluate.fit import rms
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

PATTERNS = PatternSet(1280, 720)
SENSOR = SensorNoise(gain_dn_per_e=0.17, read_noise_e=6.2, black_level_dn=64, saturation_dn=4095)
# So little noise that the rounding of the levels is most of it.
QUIET = SensorNoise(gain_dn_per_e=1e-5, read_noise_e=0.0, black_level_dn=64, saturation_dn=4095)
ACROSS_PX_PER_MM, UP_PX_PER_MM, ROWS_PX_PER_MM = 5.8, 2.9, 6.3
UM_PER_PX = 1e3 / UP_PX_PER_MM
# Fine cells per pixel along each direction, and rim of the image that is not evaluated, px.
FINE, RIM = 5, 8
CONTRAST, WHITE_DN = 0.85, 3600.0
SHAPE, QUICK_SHAPE = (320, 400), (160, 200)


@dataclass(frozen=True)
class FlakedCoat:
    """Coat with flakes that glint; all values but the paper's pixel size are assumed.

    Attributes
    ----------
    pixel_um, blur_um : width of a camera pixel on the coat, and sigma of the lens's blur there. The
        default footprint has a full width at half maximum of 21 um
    flake_um, area_share : diameter of a flake, and share of the area that flakes cover
    light_share : share of the coat's mean radiance that is from flakes; 0: a plain coat
    tilt_rad, lobe_rad : standard deviation of the flakes' tilt, and of the tilts that reflect the
        projector's aperture into the camera's
    """

    pixel_um: float = 14.8
    blur_um: float = 8.0
    flake_um: float = 15.0
    area_share: float = 0.15
    light_share: float = 0.3
    tilt_rad: float = 0.2
    lobe_rad: float = 0.05

    def radiance(self, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
        """Return the radiance on the fine grid over its mean, (row, col)."""
        rows, cols = FINE * shape[0], FINE * shape[1]
        if not self.light_share:
            return np.ones((rows, cols))
        cell_um = self.pixel_um / FINE
        radius = 0.5 * self.flake_um / cell_um
        count = rng.poisson(self.area_share * rows * cols / (np.pi * radius**2))
        places = (rng.uniform(0, (rows, cols), (count, 2))).astype(np.intp)
        tilts = rng.normal(0.0, self.tilt_rad, (count, 2)) / self.lobe_rad
        centres = np.zeros((rows, cols))
        np.add.at(centres, tuple(places.T), np.exp(-0.5 * np.sum(tilts**2, axis=1)))
        offsets = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
        disc = np.hypot(offsets[:, None], offsets) <= radius + 0.25
        flakes = np.maximum(fftconvolve(centres, disc.astype(float), mode="same"), 0.0)
        return 1.0 - self.light_share + self.light_share * flakes / flakes.mean()

    def footprint_means(self, image: FloatArray) -> FloatArray:
        """Return the mean of an image on the fine grid over each pixel's footprint, (row, col)."""
        blurred = gaussian_filter(image, self.blur_um / self.pixel_um * FINE, mode="nearest")
        return _pixel_means(blurred)

    def coordinates_px(self, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Return projector column and row of a tilted plane on the fine grid, (row, col)."""
        row, col = np.mgrid[: FINE * shape[0], : FINE * shape[1]] + 0.5
        cell_mm = 1e-3 * self.pixel_um / FINE
        return 40.0 + ACROSS_PX_PER_MM * cell_mm * col, 40.0 + ROWS_PX_PER_MM * cell_mm * row


def _pixel_means(image: FloatArray) -> FloatArray:
    rows, cols = image.shape
    return np.asarray(image.reshape(rows // FINE, FINE, cols // FINE, FINE).mean(axis=(1, 3)))


@dataclass(frozen=True, eq=False)
class FlakedCapture:
    """Frames of a coat, (frame, row, col), noise-free DN, and the true columns, (row, col) px."""

    clean_dn: FloatArray
    column_px: FloatArray

    def decoded(self, weights: Weights, sensor: SensorNoise = SENSOR, taps: int = 8) -> Decoded:
        """Return the decoded capture with the noise of a sensor."""
        return decode(
            self._recorded(sensor), PATTERNS, sensor, DecodeOptions(taps, weights=weights)
        )

    def errors_um(self, decoded: Decoded) -> FloatArray:
        """Return the errors of the height at the valid pixels off the rim, (pixel,), median 0."""
        error = UM_PER_PX * (decoded.column.coordinate_px - self.column_px)[inner(decoded)]
        return np.asarray(error - np.median(error))

    def _recorded(self, sensor: SensorNoise) -> FloatArray:
        noise = np.random.default_rng(5).normal(size=self.clean_dn.shape)
        noise *= np.sqrt(sensor.variance_dn2(self.clean_dn) - 1.0 / 12.0)
        levels = np.clip(np.rint(self.clean_dn + noise), 0, sensor.saturation_dn)
        return np.asarray(levels.astype(np.uint16))


def inner(decoded: Decoded) -> BoolImage:
    """Return the valid pixels that are not at the rim of the image, (row, col)."""
    inside = np.zeros(decoded.valid.shape, np.bool_)
    inside[RIM:-RIM, RIM:-RIM] = True
    return decoded.valid & inside


def sigma_um(axis: AxisDecode, where: BoolImage) -> FloatArray:
    """Return the stated standard deviations of the height, (pixel,)."""
    return np.asarray(UM_PER_PX * axis.sigma_px[where])


def capture(
    coat: FlakedCoat, shape: tuple[int, int] = QUICK_SHAPE, *, seed: int = 1, exposure: float = 1.0
) -> FlakedCapture:
    """Return the capture of a coat.

    Parameters
    ----------
    exposure : with 1, 99.9 % of the pixels are below full scale; more saturates glints
    """
    radiance = coat.radiance(shape, np.random.default_rng(seed))
    fine_px = coat.coordinates_px(shape)
    light = coat.footprint_means(radiance)
    gain_dn = exposure * WHITE_DN / (1.0 + CONTRAST) / max(np.quantile(light, 0.999), 1.0)
    frames = np.stack(list(_signals(coat, radiance, fine_px)))
    clean = SENSOR.black_level_dn + gain_dn * (light + CONTRAST * frames)
    return FlakedCapture(clean, _pixel_means(fine_px[0]))


def _signals(
    coat: FlakedCoat, radiance: FloatArray, fine_px: tuple[FloatArray, FloatArray]
) -> Iterator[FloatArray]:
    """Yield the modulated light of every frame, (row, col)."""
    period_px = PATTERNS.period_px
    phasors = [
        coat.footprint_means(radiance * np.cos(angle))
        + 1j * coat.footprint_means(radiance * np.sin(angle))
        for angle in (2.0 * np.pi * image / period_px for image in fine_px)
    ]
    for frame in PATTERNS.frames:
        along = 1 if frame.axis == "row" else 0
        if frame.kind == "phase":
            _, shift = PATTERNS.phase_of(frame)
            yield (phasors[along] * np.exp(2j * np.pi * shift)).real
        else:
            bright = 2.0 * (PATTERNS.profile(frame) > 127) - 1.0
            places = np.clip(np.rint(fine_px[along]).astype(np.intp), 0, bright.size - 1)
            yield coat.footprint_means(radiance * bright[places])


def capped_error_um(glinting: FlakedCapture, multiple: float) -> float:
    """Return the error, without camera noise, by weights up to a multiple of the local median."""
    single = glinting.decoded("equal", QUIET, taps=0)
    axis, per_px = single.column, np.float32(2.0 * np.pi / PATTERNS.period_px)
    most = np.float32(multiple) * median_filter(axis.modulation_dn, 9)
    change, _, _ = filter_phase(
        per_px * axis.coordinate_px,
        np.where(single.valid, np.minimum(axis.modulation_dn, most), np.float32(0.0)),
        per_px * axis.sigma_px,
        single.valid,
        gaussian_weights(8, 1.5),
    )
    moved = axis.coordinate_px + change / per_px - glinting.column_px
    error = UM_PER_PX * moved[inner(single)]
    return rms(error - np.median(error))


def coat_decoder(quick: bool) -> dict[str, float]:
    """Return the errors of a glinting coat by all weights, see the module docstring."""
    coat, shape = FlakedCoat(), QUICK_SHAPE if quick else SHAPE
    glinting, plain = (capture(c, shape) for c in (coat, replace(coat, light_share=0.0)))
    weights: tuple[Weights, Weights] = ("modulation", "equal")
    quiet = [glinting.errors_um(glinting.decoded(w, QUIET)) for w in weights]
    noisy = [glinting.errors_um(glinting.decoded(w)) for w in weights]
    even = [rms(plain.errors_um(plain.decoded(w))) for w in weights]
    robust = glinting.decoded("equal")
    bright = capture(coat, shape, exposure=3.0)
    saturated = bright.decoded("equal")
    off_px = np.abs(saturated.column.coordinate_px - bright.column_px)[saturated.valid]
    return {
        "glint_error_um_weighted": rms(quiet[0]),
        "glint_error_um_robust": rms(quiet[1]),
        "glint_error_um_capped": capped_error_um(glinting, 1.0),
        "glint_error_um_capped_at_three": capped_error_um(glinting, 3.0),
        "mae_over_rmse": float(np.mean(np.abs(quiet[0]))) / rms(quiet[0]),
        "noisy_um_weighted": rms(noisy[0]),
        "noisy_um_robust": rms(noisy[1]),
        "robust_normalised": rms(noisy[1] / sigma_um(robust.column, inner(robust))),
        "plain_noise_ratio": even[1] / even[0],
        "unmasked_wrong": int(np.sum(off_px > 0.5 * PATTERNS.period_px)),
        "masked_share": 1.0 - float(saturated.valid.mean()),
    }


def main() -> None:
    parser = quick_parser(__doc__, "160 x 200 px instead of 320 x 400")
    print_figures(coat_decoder(parser.parse_args().quick))


if __name__ == "__main__":
    main()

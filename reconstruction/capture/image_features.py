"""Compute features of images of unknown content: level, axis and frequency of the stripes.

Of each image some lines along rows and some along columns are used, at full resolution. The level u
of a pixel is its value after normalisation: 0 at the darkest, 1 at the brightest value of the pixel
in all images. This removes coat, object and lighting. Pixels that hardly change are excluded and
called not lit.

An image that varies along projector columns varies within the lines along rows and is uniform
within the lines along columns. The frequency is at the peak of the mean power spectrum of the
lines.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.capture.image_files import Image, read_image
from reconstruction.capture.recorded import Channel, natural_key
from reconstruction.errors import CaptureError
from reconstruction.patterns import Axis

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".exr", ".pgm", ".npy")
LINES = 64
# A pixel is used if it changes by at least this share of the change of well-lit pixels.
LIT_SHARE = 0.3
# An image is uniform if the variance of u is below the first value; then it is white if the mean of
# u is above the second value, and black if it is below the third.
UNIFORM, WHITE, BLACK = 0.03, 0.7, 0.3
# Faint stripes are detected above this variance of u and this ratio of variations along both axes.
FAINT, FAINT_RATIO = 0.001, 2.5
# Least ratio of the variations along both axes at which the axis of the stripes is certain.
CERTAIN = 3.0
# A pixel is dark or bright if its u is within this distance of 0 or 1.
EXTREME = 0.15
NAMED = {
    "white": ("white", "bright", "full_on"),
    "black": ("black", "dark", "full_off"),
    "column": ("column", "col_", "vertical", "_x_", "_v_"),
    "row": ("row", "horizontal", "_y_", "_h_"),
}
# Length of a zero-padded line, in line lengths; it gives finer steps of the spectrum.
PADDED = 8


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """Features of one image of unknown content.

    Parameters
    ----------
    file : path relative to the folder
    mean : mean of the level u
    kind : "white", "black", "grey", "striped", or "faint" (stripes of little contrast)
    axis : projector axis along which the image varies most
    certainty : variation along `axis`, divided by that along the other axis, >= 1
    frequency : frequency of the stripes, cycles per camera pixel along the axis; 0: no stripes
    smooth : share of the pixels that are neither dark nor bright
    along : for each axis (line, sample) u - 1/2 on the lines along it; 0 where not lit
    lit : for each axis (line, sample) bool, whether the sample is lit
    """

    file: str
    mean: float
    kind: str
    axis: Axis
    certainty: float
    frequency: float
    smooth: float
    along: Mapping[Axis, FloatImage]
    lit: Mapping[Axis, BoolImage]

    @property
    def lines(self) -> FloatImage:
        """The levels u - 1/2 on the lines along the axis of the image, (line, sample)."""
        return self.along[self.axis]

    @property
    def is_lit(self) -> BoolImage:
        """Whether the samples of `lines` are lit, (line, sample) bool."""
        return self.lit[self.axis]


@dataclass(frozen=True)
class FrameGroup:
    """Images of equal kind, which make one table [[frames]] of capture.toml.

    Parameters
    ----------
    kind, axis : as in `FrameEntry`
    files : paths relative to the folder, in the order of projection
    shifts_deg : shift of each phase frame; relative to the first image if `sign` is 0
    frequency : cycles per camera pixel of the fringes, or of the finest bit
    sign : sign of the shifts, 1 or -1; 0: not known
    """

    kind: str
    axis: Axis | None
    files: tuple[str, ...]
    shifts_deg: tuple[float, ...] = ()
    frequency: float = 0.0
    sign: int = 0


@dataclass(frozen=True, eq=False)
class FolderFeatures:
    """Features of all images of a folder.

    Parameters
    ----------
    features : features of the images of the most frequent size, in natural order of their names
    left_out : files of another size
    channel : channel that was read of colour images; "": the images are grey
    largest : largest value in the images, DN
    dtype : data type of the images
    darkest_dn : estimated value of pixels without light, DN
    """

    features: tuple[ImageFeatures, ...]
    left_out: tuple[str, ...]
    channel: Channel
    largest: float
    dtype: str
    darkest_dn: float


def analyse_folder(folder: Path) -> FolderFeatures:
    """Return the features of all images of a folder and its subfolders.

    Raises
    ------
    CaptureError : there are fewer than three images, one is damaged, or all are equal
    """
    files = sorted(
        (p for pattern in ("*", "*/*") for p in folder.glob(pattern) if _is_image(p)),
        key=natural_key,
    )
    if len(files) < 3:
        raise CaptureError(
            f"{folder}: holds {len(files)} images ({', '.join(SUFFIXES)}); give a folder of frames"
        )
    first = [_read(path) for path in files]
    sizes = Counter(image.shape[:2] for image, _ in first)
    size = sizes.most_common(1)[0][0]
    same_size = [k for k, (image, _) in enumerate(first) if image.shape[:2] == size]
    names = [path.relative_to(folder).as_posix() for path in files]
    images = [first[k][0] for k in same_size]
    features = _all_features([names[k] for k in same_size], images)
    return FolderFeatures(
        features,
        tuple(name for k, name in enumerate(names) if k not in same_size),
        "green" if any(first[k][1] for k in same_size) else "",
        max(float(image.max()) for image in images),
        images[0].dtype.name,
        float(np.percentile(np.min([image[::7, ::7] for image in images], axis=0), 1.0)),
    )


def _read(path: Path) -> tuple[Image, bool]:
    """Return an image, or the green channel of a colour image, and True if it has colours."""
    try:
        return read_image(path), False
    except CaptureError:
        return read_image(path, "green"), True


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES and path.is_file()


def _all_features(names: Sequence[str], images: Sequence[Image]) -> tuple[ImageFeatures, ...]:
    rows, cols = (_places(length) for length in images[0].shape)
    along: dict[Axis, FloatArray] = {
        "column": np.stack([image[rows] for image in images]).astype(np.float64),
        "row": np.stack([image[:, cols].T for image in images]).astype(np.float64),
    }
    low = {axis: lines.min(axis=0) for axis, lines in along.items()}
    span = {axis: lines.max(axis=0) - low[axis] for axis, lines in along.items()}
    bright = max(float(np.percentile(lines, 95.0)) for lines in span.values())
    if bright <= 0.0:
        raise CaptureError("all images are the same; give the frames of a sequence")
    lit = {axis: lines > LIT_SHARE * bright for axis, lines in span.items()}
    features = []
    for k, name in enumerate(names):
        u = {
            axis: np.where(
                lit[axis], (along[axis][k] - low[axis]) / np.maximum(span[axis], 1e-9), 0
            )
            for axis in along
        }
        features.append(_image_features(name, u, lit))
    return tuple(features)


def _places(length: int) -> NDArray[np.int_]:
    """Return the numbers of evenly spaced lines, without 5 % of `length` at both ends."""
    return np.unique(np.linspace(0.05 * length, 0.95 * length - 1, LINES).astype(int))


def _image_features(
    name: str, u: dict[Axis, FloatArray], lit: dict[Axis, BoolImage]
) -> ImageFeatures:
    mean = float(u["column"].sum() / max(lit["column"].sum(), 1))
    strengths = {axis: _strength(u[axis], lit[axis]) for axis in u}
    column, row = strengths["column"], strengths["row"]
    axis: Axis = "column" if column >= row else "row"
    certainty = max(column, row) / max(min(column, row), 1e-9)
    whole = float(np.var(u["column"][lit["column"]])) if lit["column"].any() else 0.0
    along = {a: np.where(lit[a], u[a] - 0.5, 0.0) for a in u}
    kind = _kind(whole, mean, certainty)
    between = np.abs(along[axis][lit[axis]]) < 0.5 - EXTREME
    frequency = peak(along[axis]) if kind in ("striped", "faint") else 0.0
    smooth = float(np.mean(between)) if between.size else 0.0
    return ImageFeatures(name, mean, kind, axis, certainty, frequency, smooth, along, lit)


def _kind(variance: float, mean: float, certainty: float) -> str:
    if variance >= UNIFORM:
        return "striped"
    if not BLACK <= mean <= WHITE:
        return "white" if mean > WHITE else "black"
    return "faint" if variance > FAINT and certainty > FAINT_RATIO else "grey"


def _strength(u: FloatArray, is_lit: BoolImage) -> float:
    """Return the variation of u within lines: variance times mean step from pixel to pixel."""
    count = np.maximum(is_lit.sum(axis=1), 1)
    mean = u.sum(axis=1) / count
    variance = np.where(is_lit, (u - mean[:, np.newaxis]) ** 2, 0.0).sum(axis=1) / count
    both = is_lit[:, 1:] & is_lit[:, :-1]
    steps = np.abs(np.diff(u, axis=1))[both]
    return float((np.mean(variance) + 1e-4) * (float(np.mean(steps)) if steps.size else 0.0))


def spectrum(lines: FloatImage) -> FloatArray:
    """Return the Fourier transform (line, frequency) of each line (line, sample) minus its mean.

    The lines are multiplied by a Hann window and padded with zeros.
    """
    count = lines.shape[1]
    window = np.hanning(count)
    mean = (lines * window).sum(axis=1, keepdims=True) / window.sum()
    return np.asarray(np.fft.rfft((lines - mean) * window, PADDED * count, axis=1))


def peak(lines: FloatImage) -> float:
    """Return the strongest frequency of the lines, cycles per sample."""
    power = np.sum(np.abs(spectrum(lines)) ** 2, axis=0)
    return float(max(int(np.argmax(power)), 1) / (PADDED * lines.shape[1]))


def named(image: ImageFeatures) -> set[str]:
    """Return the words white, black, column and row that the name of an image contains or means."""
    padded = f"_{image.file.lower()}_"
    return {name for name, parts in NAMED.items() if any(part in padded for part in parts)}

"""Search the numbers of calibration files by all names that programs use for a quantity.

A name in a file is compared in lower case without separators. It is that of the device and that of
the quantity, in either order, or both separated by "/". Names that differ by case only (`Kc` and
`kc` of SLStudio) are distinguished by the number of elements.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, few

DEVICES = ("camera", "projector")
DEVICE_NAMES = {
    "camera": ("camera", "cam", "left", "l", "1", "c"),
    "projector": ("projector", "proj", "prj", "right", "r", "2", "p", "dlp"),
}
"""Names of the first and of the second device of a file, in lower case."""

MATRIX = (
    *("cameramatrix", "intrinsicmatrix", "intrinsics", "int", "matrix", "mtx"),
    *("kk", "k", "m", "a"),
)
DISTORTION = ("distortioncoefficients", "distcoeffs", "distortion", "dist", "kc", "d", "k")
WIDTHS, HEIGHTS = ("imagewidth", "width", "w", "nx"), ("imageheight", "height", "h", "ny")
SIZES, SHAPES = ("imagesize", "size", "resolution"), ("imgshape", "imageshape", "shape")
ROTATION = ("r", "rotation", "rotationmatrix", "rmat", "rvec", "om", "rstereo", "stereor")
TRANSLATION = ("t", "translation", "translationvector", "tvec", "tstereo", "stereot")
COEFFICIENTS = (4, 5, 8, 12, 14)
"""Numbers of distortion coefficients of OpenCV's models."""

QUANTITIES = (
    *(
        f"{device}_{quantity}"
        for device in DEVICES
        for quantity in ("matrix", "distortion", "size", "shape", "width", "height")
    ),
    "rotation",
    "translation",
    "motion",
)
"""Quantities that `--key QUANTITY=NAME` can assign to a name in a file."""

# Largest number of a calibration; squares of it are finite.
_MOST = 1e100

NO_DISTORTION = "none"
"""Name for `--key camera_distortion=none`: the lens has no distortion."""


def plain(name: str) -> str:
    """Return a name in lower case without separators except "/"."""
    return "".join(sign for sign in name.lower() if sign.isalnum() or sign == "/")


@dataclass(eq=False)
class NamedNumbers:
    """Numbers and matrices of calibration files, and which of them were used.

    Attributes
    ----------
    numbers : arrays by their names in the files
    keys : name in the files by quantity; takes precedence over the usual names
    used : name in the files of each required quantity, filled by the searches
    """

    numbers: Mapping[str, FloatArray]
    keys: Mapping[str, str] = field(default_factory=dict)
    used: dict[str, str] = field(default_factory=dict)

    def of_device(
        self, device: str, quantity: str, names: Sequence[str], sizes: Collection[int]
    ) -> FloatArray | None:
        """Return the first array with a name made of a device's and a quantity's name, or None.

        Parameters
        ----------
        device : "camera" or "projector"
        quantity : "matrix", "distortion", ...; with the device's name a key of `keys`; "": no key
        names : possible names of the quantity, before or after that of the device
        sizes : allowed numbers of elements; K1 is a matrix in one program, a coefficient in another
        """
        label = f"{device} {names[0]}"
        if quantity and (name := self.keys.get(f"{device}_{quantity}")):
            return self._keyed(f"{device}_{quantity}", label, name, sizes)
        forms = [
            form
            for name in names
            for prefix in DEVICE_NAMES[device]
            for form in (
                prefix + name,
                name + prefix,
                f"{prefix}/{name}",
                f"cameraparameters{prefix}/{name}",
            )
        ]
        return self._first(label, forms, sizes)

    def of_rig(
        self, quantity: str, names: Sequence[str], sizes: Collection[int]
    ) -> FloatArray | None:
        """Return the first array with one of these names and numbers of elements, or None."""
        if name := self.keys.get(quantity):
            return self._keyed(quantity, quantity, name, sizes)
        return self._first(names[0], names, sizes)

    def missing(self, quantity: str, key: str, sizes: Collection[int]) -> InputError:
        """Return the error to raise if a quantity has none of its usual names.

        Parameters
        ----------
        quantity : description of the quantity for the message
        key : quantity of `--key`
        sizes : allowed numbers of elements, which select the names that the message lists
        """
        fitting = [name for name, values in self.numbers.items() if values.size in sizes]
        device = key.partition("_")[0]
        is_single = all(name.startswith("camera/") for name in self.numbers)
        file = f"give the {device}'s file as well, or " if is_single and device in DEVICES else ""
        return InputError(
            f"no {quantity} is found; the file holds {few(sorted(self.numbers)) or '-'}, of the "
            f"right size {', '.join(sorted(fitting)[:8]) or 'none'}; {file}name it by --key "
            f"{key}=NAME"
        )

    def _first(self, label: str, forms: Sequence[str], sizes: Collection[int]) -> FloatArray | None:
        by_name: dict[str, list[str]] = {}
        for name in self.numbers:
            by_name.setdefault(plain(name), []).append(name)
        for form in forms:
            for name in by_name.get(form, ()):
                if self.numbers[name].size in sizes:
                    return self._used(label, name)
        return None

    def _used(self, label: str, name: str) -> FloatArray:
        values = self.numbers[name]
        if not bool(np.all(np.abs(values) < _MOST)):
            raise InputError(f"{name} is {values.tolist()}; allowed are finite numbers")
        self.used[label] = name
        return values

    def _keyed(self, key: str, label: str, name: str, sizes: Collection[int]) -> FloatArray:
        if name == NO_DISTORTION and key.endswith("distortion"):
            self.used[label] = name
            return np.zeros(5)
        if name not in self.numbers:
            raise InputError(
                f"--key {key}={name}: the files hold no number {name}; they hold "
                f"{', '.join(sorted(self.numbers)[:20]) or '-'}"
            )
        values = self.numbers[name]
        if values.size not in sizes:
            raise InputError(
                f"--key {key}={name}: found {values.size} numbers, allowed "
                f"{' or '.join(map(str, sorted(sizes)))}"
            )
        return self._used(label, name)


def parsed_keys(assignments: Sequence[str]) -> dict[str, str]:
    """Return the name in the files by quantity, from texts QUANTITY=NAME.

    Raises
    ------
    InputError : a text has no "=", or an unknown quantity
    """
    keys = {}
    for text in assignments:
        quantity, sign, name = text.partition("=")
        if not (sign and name and quantity in QUANTITIES):
            raise InputError(
                f"--key {text}: write QUANTITY=NAME; quantities are {', '.join(QUANTITIES)}"
            )
        keys[quantity] = name
    return keys

"""Which parameters are free: a field of a few degrees does not determine all of them.

Defaults, with reasons:

- square pixels (fy = fx for camera and projector): both chips are made that way to better than the
  0.01 % that the poses could tell;
- camera k1 only: over a field of 4 degrees k2 and k3 act far below the noise, and tangential terms
  cannot be told from the principal point;
- no projector distortion: the board covers a small patch of the image, off its axis, where a radial
  term looks like a shift and a change of focal length;
- both principal points free: an error of the camera's turns into a tilt, the projector's lies far
  off-axis and is not known beforehand;
- defocus of the camera (`reconstruction/calibration/defocus.py`): two coefficients, zero for a
  camera that is sharp everywhere; neglected they would lean on principal points and rotations.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.calibration.parameters import CAMERA, INTRINSICS, PROJECTOR, STEREO
from reconstruction.errors import InputError

Distortion = Literal["k1", "k2", "p1", "p2", "k3"]


@dataclass(frozen=True)
class Freedom:
    """Free parameters of the devices; motions are always free.

    Parameters
    ----------
    camera_distortion, projector_distortion : names of the coefficients to estimate
    camera_principal_point, projector_principal_point : estimate it
    square_pixels : one focal length for both axes
    camera_defocus : estimate what the camera's aperture does to tilted boards

    Raises
    ------
    InputError : unknown coefficient
    """

    camera_distortion: tuple[Distortion, ...] = ("k1",)
    projector_distortion: tuple[Distortion, ...] = ()
    camera_principal_point: bool = True
    projector_principal_point: bool = True
    square_pixels: bool = True
    camera_defocus: bool = True

    def __post_init__(self) -> None:
        for name in (*self.camera_distortion, *self.projector_distortion):
            if name not in INTRINSICS[4:]:
                allowed = ", ".join(INTRINSICS[4:])
                raise InputError(f"distortion coefficient is {name!r}; allowed are {allowed}")


def admissible(freedom: Freedom, vector: Doubles) -> Doubles:
    """Return the parameter vector moved to where the fixed relations hold."""
    moved = vector.copy()
    if freedom.square_pixels:
        for device in (CAMERA, PROJECTOR):
            focal = slice(device.start, device.start + 2)
            moved[focal] = np.sqrt(np.prod(vector[focal]))
    return moved


def freedom_matrix(freedom: Freedom, size: int) -> Doubles:
    """Return the map (parameters, free) from free changes to changes of all `size` parameters."""
    columns: list[Doubles] = []
    settings = (
        (CAMERA.start, freedom.camera_principal_point, freedom.camera_distortion),
        (PROJECTOR.start, freedom.projector_principal_point, freedom.projector_distortion),
    )
    for first, principal_point, distortion in settings:
        columns += _focal_columns(size, first, freedom.square_pixels)
        names = (("cx_px", "cy_px") if principal_point else ()) + tuple(distortion)
        columns += [_unit(size, first + INTRINSICS.index(name)) for name in names]
    columns += [_unit(size, k) for k in range(STEREO.start, size)]
    return np.stack(columns, axis=1)


def _focal_columns(size: int, first: int, square: bool) -> list[Doubles]:
    fx, fy = _unit(size, first), _unit(size, first + 1)
    return [fx + fy] if square else [fx, fy]


def _unit(size: int, index: int) -> Doubles:
    column = np.zeros(size)
    column[index] = 1.0
    return column

"""Camera rays of one image row: the inverse of the lens distortion, a whole row per step."""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

from reconstruction._jit import compiled, inlined
from reconstruction.rig.pinhole import (
    INVERSE_STEPS,
    NO_DISTORTION,
    Pinhole,
    distort,
    distortion_jacobian,
    fold_square,
    is_before_fold,
    newton_step,
)

# Newton squares the error: a step below 1e-7 leaves far less than 1e-12.
RAY_TOLERANCE = 1e-7

distort_inlined = inlined(distort)
distortion_jacobian_inlined = inlined(distortion_jacobian)
newton_step_inlined = inlined(newton_step)
is_before_fold_inlined = inlined(is_before_fold)


class Lens(NamedTuple):
    """Intrinsics of one device, pixels and OpenCV coefficients."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    is_ideal: bool
    fold_square: float


def lens_of(device: Pinhole) -> Lens:
    """Return the intrinsics of a device as the kernels take them."""
    k1, k2, p1, p2, k3 = (float(value) for value in device.distortion)
    return Lens(
        float(device.fx_px),
        float(device.fy_px),
        float(device.cx_px),
        float(device.cy_px),
        (k1, k2, p1, p2, k3),
        tuple(device.distortion) == NO_DISTORTION,
        fold_square(device.distortion),
    )


@compiled
def _newton_row(
    row: int, camera: Lens, x_bend: Any, y_bend: Any, x: Any, y: Any, found: Any
) -> Any:  # fmt: skip
    """Improve the rays of a row by one Newton step; return how many have not converged."""
    x_scale, y_target = 1.0 / camera.fx, (row - camera.cy) / camera.fy
    pending = 0
    for col in range(x.size):
        x_target = (col - camera.cx) * x_scale
        x_old, y_old = x_target + x_bend[col], y_target + y_bend[col]
        x_now, y_now = distort_inlined(x_old, y_old, camera.distortion)
        jacobian = distortion_jacobian_inlined(x_old, y_old, camera.distortion)
        dx, dy = newton_step_inlined(x_target - x_now, y_target - y_now, jacobian)
        x[col], y[col] = x_old + dx, y_old + dy
        x_bend[col], y_bend[col] = x_bend[col] + dx, y_bend[col] + dy
        is_close = abs(dx) + abs(dy) < RAY_TOLERANCE
        is_before = is_before_fold_inlined(x_old, y_old, jacobian, camera.fold_square)
        found[col] = is_close & is_before
        pending += not is_close
    return pending


@compiled
def _ideal_row(row: int, camera: Lens, x: Any, y: Any, found: Any) -> None:
    x_scale, y_target = 1.0 / camera.fx, (row - camera.cy) / camera.fy
    for col in range(x.size):
        x[col], y[col], found[col] = (col - camera.cx) * x_scale, y_target, True


@compiled
def _forget_lost(found: Any, x_bend: Any, y_bend: Any) -> None:
    for col in range(found.size):
        x_bend[col] = x_bend[col] if found[col] else 0.0
        y_bend[col] = y_bend[col] if found[col] else 0.0


@compiled
def ray_row(
    row: int, camera: Lens, x_bend: Any, y_bend: Any, x: Any, y: Any, found: Any
) -> None:  # fmt: skip
    """Write the rays (x, y, 1) of an image row in the camera frame, and where there is one.

    x_bend, y_bend : how far the lens bends each ray. Those of the row before are a good start, as
        neighbours bend alike: one step is enough in all but the first row.
    """
    if camera.is_ideal:
        _ideal_row(row, camera, x, y, found)
        return
    for _ in range(INVERSE_STEPS):
        if _newton_row(row, camera, x_bend, y_bend, x, y, found) == 0:
            break
    _forget_lost(found, x_bend, y_bend)

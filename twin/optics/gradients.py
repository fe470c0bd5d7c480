"""Derivatives of the trace maps and of the frames by design fields, by Dr.Jit.

A design field changes numbers of the scene: coat parameters, intrinsics and poses of both devices,
the projector's irradiance. The derivatives of these numbers by the field are central differences.
They are accurate, because the numbers are elementary functions of the field in double precision.
All later quantities (rays, hits, BSDF, projector pixel, frames) are differentiated in forward mode
through the one-trace renderer, at its fixed sub-pixel positions. One pass per field yields the
derivatives of all pixels.

As in every renderer that differentiates under the integral, the motion of edges of shadows and
outlines is not included. The surface is constant: the effect of a field on the press is not
included either.

Import and use this module within a `renderer_session`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole
from twin.config.models import Experiment
from twin.optics.connection import FrameLight, Rig
from twin.optics.devices import Device
from twin.optics.light import LightTable
from twin.optics.materials import COATED_FACE, bsdf_numbers, listed_as
from twin.optics.one_trace import Patches, frames_of_patches, maps_of, trace_patches
from twin.optics.rig import irradiance_at_1mm, true_calibration
from twin.optics.scene import coating_in_layer
from twin.optics.stack import Frames, TraceMaps

Vary = Callable[[float], Experiment]
"""Function of an amount; it returns the experiment with one design field changed by this amount."""


@dataclass(frozen=True)
class MovingPinhole:
    """Intrinsics as differentiable Dr.Jit numbers: the attributes of `Pinhole` that rays need."""

    width_px: int
    height_px: int
    fx_px: Any
    fy_px: Any
    cx_px: Any
    cy_px: Any
    distortion: tuple[float, ...]


@dataclass(frozen=True)
class MovingDevice(Device):
    """A device with derivatives of its pose and intrinsics.

    Attributes
    ----------
    pose : (3, 4); upper rows of the pose as differentiable Dr.Jit numbers, used instead of
        `T_world_from_device`
    """

    pose: tuple[tuple[Any, ...], ...] = ()

    @property
    def position_mm(self) -> Any:
        """World position of the pinhole, `mi.Point3f`, mm."""
        return mi.Point3f(*(row[3] for row in self.pose))

    def _axes(self) -> tuple[Any, Any, Any]:
        right, down, forward = (mi.Vector3f(*(row[k] for row in self.pose)) for k in range(3))
        return right, down, forward


def derivative(numbers: Callable[[Experiment], FloatArray], vary: Vary, step: float) -> FloatArray:
    """Return the derivative of `numbers(experiment)` by one field, as a central difference.

    Parameters
    ----------
    vary : changes the field by an amount
    step : half the difference of the field's two values, in the field's unit
    """
    return np.asarray((numbers(vary(step)) - numbers(vary(-step))) / (2.0 * step), np.float64)


@dataclass(frozen=True, eq=False)
class Tangent:
    """Derivatives of a trace by one field, per unit of the field.

    Attributes
    ----------
    maps : derivatives of the trace maps, except `lit` and `samples`, which are copied from the
        trace
    frames : derivatives of the radiance of each frame, in the order of the sequence; None if they
        were not requested
    """

    maps: TraceMaps
    frames: Frames | None = None


def trace_tangent(
    scene: Any,
    rig: Rig,
    experiment: Experiment,
    vary: Vary,
    *,
    step: float,
    tables: dict[str, LightTable] | None = None,
) -> Tangent:
    """Return the derivatives of the trace maps, and on request of the frames, by one field.

    Parameters
    ----------
    scene : Mitsuba scene with the experiment's coat
    vary : changes the field by an amount
    step : amount for the central differences of the scene's numbers, in the field's unit
    tables : light of the patterns, assumed independent of the field; None: no frames are computed

    Raises
    ------
    InputError : the experiment has layers, depth of field or glints, which are not differentiated
    """
    glints = experiment.coating.facets() is not None
    if rig.layers is not None or rig.camera.lens is not None or glints:
        raise InputError(
            "gradient: found layers, camera.depth_of_field or coating.glints, which are not "
            "differentiated; remove them, or search by sampling.method = 'optimise'"
        )
    amount = mi.Float(0.0)
    dr.enable_grad(amount)
    moving = _moving_rig(rig, experiment, vary, step, amount)
    with _moving_coat(scene, experiment, vary, step, amount):
        # Loops that read numbers with derivatives have to be evaluated, not recorded.
        with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
            patches = trace_patches(scene, moving, experiment.render.samples)
            frames: list[Any] = []
            if tables is not None:
                light = FrameLight(tables)
                frames = frames_of_patches(scene, moving, light, patches)
        # Frames are computed from the maps; the maps' own derivatives must remain.
        dr.forward(amount, flags=dr.ADFlag.ClearEdges)
        tangent = _tangent_maps(patches, rig.camera.pinhole)
        if tables is None:
            return Tangent(tangent)
        shape = rig.camera.pinhole.height_px, rig.camera.pinhole.width_px
        images = {
            k: np.asarray(dr.grad(frame)).reshape(shape)
            for frame, k in zip(frames, light.sequence, strict=True)
        }
        return Tangent(tangent, tuple(images[k] for k in range(len(images))))


def _tangent_maps(patches: Patches, camera: Pinhole) -> TraceMaps:
    """Return the derivatives of each pixel's weight and of its weighted mean positions."""
    values = maps_of(patches, camera)
    shape, lit = (camera.height_px, camera.width_px), values.lit

    def image(value: Any) -> FloatArray:
        return np.asarray(dr.grad(value), np.float64).reshape(shape)

    weight = np.where(lit, image(patches.weight), 0.0)
    scale = np.divide(1.0, values.weight, out=np.zeros(shape), where=lit)

    def mean(weighted: Any, position: FloatArray) -> FloatArray:
        return scale * (image(weighted) - position * weight)

    zero = np.zeros(shape)  # the change of a pixel's extent is of second order
    return TraceMaps(
        weight=weight,
        column_px=mean(patches.weighted_column, values.column_px),
        row_px=mean(patches.weighted_row, values.row_px),
        axial_mm=mean(patches.weighted_axial_mm, values.axial_mm),
        column_range_px=zero,
        row_range_px=zero,
        lit=lit,
        samples=patches.samples,
    )


def _moving_rig(rig: Rig, experiment: Experiment, vary: Vary, step: float, amount: Any) -> Rig:
    def numbers(moved: Experiment) -> FloatArray:
        rig = true_calibration(moved)
        light = irradiance_at_1mm(moved.projector, rig.projector)
        parts = [[p.fx_px, p.fy_px, p.cx_px, p.cy_px] for p in (rig.camera, rig.projector)]
        poses = [pose[:3].ravel() for pose in (rig.T_world_from_cam, rig.T_world_from_proj)]
        return np.concatenate([*parts, *poses, [light]])

    slopes = derivative(numbers, vary, step)
    values = numbers(experiment)
    moved = [
        mi.Float(value) + amount * slope
        for value, slope in zip(values.tolist(), slopes.tolist(), strict=True)
    ]
    return Rig(
        camera=_moving_device(rig.camera, moved[:4], moved[8:20]),
        projector=_moving_device(rig.projector, moved[4:8], moved[20:32]),
        irradiance_at_1mm=moved[32],
        shadows=rig.shadows,
        heights=rig.heights,
        dots=rig.dots,
    )


def _moving_device(device: Device, intrinsics: list[Any], pose: list[Any]) -> MovingDevice:
    still = device.pinhole
    fx, fy, cx, cy = intrinsics
    pinhole = MovingPinhole(still.width_px, still.height_px, fx, fy, cx, cy, still.distortion)
    rows = tuple(tuple(pose[4 * n : 4 * n + 4]) for n in range(3))
    return MovingDevice(pinhole, device.T_world_from_device, None, rows)  # type: ignore[arg-type]


class _moving_coat:  # noqa: N801 - read as a function
    """Context in which the coat's parameters carry their derivatives by the field."""

    def __init__(
        self, scene: Any, experiment: Experiment, vary: Vary, step: float, amount: Any
    ) -> None:
        self._parameters = mi.traverse(_face(scene).bsdf())
        self._moved = {}
        still, low, high = (
            dict(bsdf_numbers(coating_in_layer(moved).bsdf()))
            for moved in (experiment, vary(-step), vary(step))
        )
        for name, value in still.items():
            slope = (high[name] - low[name]) / (2.0 * step)
            listed = listed_as(name, self._parameters)
            if slope and listed is not None:
                kind = type(self._parameters[listed])
                self._moved[listed] = kind(value), kind(mi.Float(value) + amount * slope)

    def __enter__(self) -> None:
        self._set(1)

    def __exit__(self, *_: object) -> None:
        self._set(0)

    def _set(self, which: int) -> None:
        for name, values in self._moved.items():
            self._parameters[name] = values[which]
        if self._moved:
            self._parameters.update()


def _face(scene: Any) -> Any:
    return next(shape for shape in scene.shapes() if shape.id() == COATED_FACE)

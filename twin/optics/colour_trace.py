"""Linear RGB images of a coat under lamps; one trace contains the light of all lamps.

Camera rays are refracted by the layers (see `layers`) and meet the coat. Each hit is connected to
every LED of every lamp, and to the mirror image of every LED in the outer face of the layers.
Sub-pixel positions are the fixed grid of the one-trace renderer.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.rig.pinhole import Pinhole
from twin.config.layers import outer_face
from twin.config.models import Experiment
from twin.optics.albedo import albedo_of
from twin.optics.connection import first_hit, shaded, truth_of
from twin.optics.devices import Device, SubPixels
from twin.optics.heights import MarchedHeights
from twin.optics.lamps import Emitters, emitters_of, sky_seen
from twin.optics.layers import LayerStack
from twin.optics.printed_dots import PrintedDots
from twin.optics.scene import (
    bsdf_on,
    check_below_layers,
    coating_in_layer,
    heights_of,
    layer_stack,
    marched_scene,
)
from twin.optics.stack import Truth

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class LampRig:
    """Inputs of a colour trace: camera, emitters, layers (None: air) and printed dots.

    If `shadows` is False, no shadow rays are traced. If `heights` is given, the scene is that sheet
    only, and rays are marched over its grid. If the coat is `matte`, its BRDF does not depend on
    direction and is evaluated once per hit instead of once per LED.
    """

    camera: Device
    emitters: Emitters
    layers: LayerStack | None = None
    dots: PrintedDots | None = None
    shadows: bool = True
    heights: MarchedHeights | None = None
    matte: bool = False


class ColourScene:
    """Mitsuba scene of a coated face under lamps, loaded once; `put` replaces the face.

    Parameters
    ----------
    experiment : its lamps, layers, coating and printed dots are used; its specimen is not
    face : coated face in world mm
    """

    def __init__(self, experiment: Experiment, face: "trimesh.Trimesh") -> None:
        bsdf = bsdf_on(face, coating_in_layer(experiment))
        self._scene = marched_scene(experiment, face, bsdf)
        self._heights, self._facets = heights_of(face), len(face.faces)
        self._samples = experiment.render.samples
        self._lamps = experiment.lamps
        self._layers, self._stack = experiment.layers, layer_stack(experiment)
        self._markers = experiment.photometric.markers
        self._dots = PrintedDots.on(self._markers, face)
        self._matte = experiment.coating.is_matte

    def put(self, face: "trimesh.Trimesh") -> None:
        """Replace the face by another face with the same grid of facets.

        Raises
        ------
        InputError : the face protrudes from the layers above it
        """
        check_below_layers(self._layers, face)
        if len(face.faces) != self._facets:
            raise ValueError(f"the face has {len(face.faces)} facets, the scene {self._facets}")
        self._scene.put(face)
        self._heights, self._dots = heights_of(face), PrintedDots.on(self._markers, face)

    def render(
        self, pinhole: Pinhole, T_world_from_cam: FloatArray, flux: FloatArray | None = None
    ) -> FloatImage:
        """Return the camera image as radiance in air, (row, col, channel), mW / (mm^2 sr).

        Parameters
        ----------
        flux : (LED,) float, optional
            Flux of each LED, relative to its nominal flux, in the order of `emitters_of`.
        """
        rig = self._rig(pinhole, T_world_from_cam, flux)
        return trace_channels(self._scene, rig, self._samples)

    def truth(self, pinhole: Pinhole, T_world_from_cam: FloatArray) -> Truth:
        """Return the true surface at the pixel centres; `lit` is True for every visible point."""
        return trace_face(self._scene, self._rig(pinhole, T_world_from_cam))

    def albedo(self, pinhole: Pinhole, T_world_from_cam: FloatArray) -> FloatImage:
        """Return the albedo (row, col) of the coat at the pixel centres, see `albedo_of`."""
        return albedo_of(self._scene, self._rig(pinhole, T_world_from_cam))

    def _rig(
        self, pinhole: Pinhole, T_world_from_cam: FloatArray, flux: FloatArray | None = None
    ) -> LampRig:
        camera = Device(pinhole, T_world_from_cam)
        emitters = emitters_of(self._lamps, flux, face=outer_face(self._layers))
        return LampRig(
            camera,
            emitters,
            self._stack,
            self._dots,
            heights=self._heights,
            matte=self._matte,
        )


def trace_channels(scene: Any, rig: LampRig, samples: int) -> FloatImage:
    """Render the camera image in the three colour channels.

    Parameters
    ----------
    scene : world in mm; emitters and sensors in it are ignored
    samples : a square number: camera rays per pixel

    Returns
    -------
    (row, col, channel) float32; radiance in air, mW / (mm^2 sr)
    """
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    grid, table = SubPixels.of_image(width, height, samples), _Table.of(rig.emitters)

    def add_sample(*state: Any) -> tuple[Any, ...]:
        sample, total = state
        return sample + 1, total + _shaded(scene, rig, table, grid.ray(rig.camera, sample))

    start = mi.UInt32(0), dr.zeros(mi.Color3f, width * height)
    total = dr.while_loop(start, lambda sample, _: sample < samples, add_sample)[1] / samples
    dr.eval(total)
    return np.stack([np.asarray(channel).reshape(height, width) for channel in total], axis=-1)


@dataclass(frozen=True, eq=False)
class _Table:
    """`Emitters` as Dr.Jit arrays on the computing device."""

    position_mm: Any
    aim: Any
    exponent: Any
    intensity: Any
    fill: Any
    mirrored: Any
    ior: Any
    dark_cap: Any
    count: Any

    @classmethod
    def of(cls, emitters: Emitters) -> "_Table":
        return cls(
            mi.Point3f(*emitters.positions_mm.T.astype(np.float32)),
            mi.Vector3f(*emitters.aims.T.astype(np.float32)),
            mi.Float(emitters.exponents.astype(np.float32)),
            mi.Color3f(*emitters.intensity.T.astype(np.float32)),
            mi.Color3f(*(dr.opaque(mi.Float, float(part)) for part in emitters.fill)),
            mi.Bool(emitters.mirrored),
            dr.opaque(mi.Float, emitters.ior),
            dr.opaque(mi.Float, emitters.dark_cap),
            dr.opaque(mi.UInt32, len(emitters.exponents)),  # a literal would be compiled in
        )


def _shaded(scene: Any, rig: LampRig, table: _Table, ray: Any) -> Any:
    """Return the radiance in air along camera rays, `mi.Color3f`, mW / (mm^2 sr)."""
    sight = None if rig.layers is None else rig.layers.refract(ray)
    ray = ray if sight is None else sight.ray
    hit = first_hit(scene, rig.heights, ray)
    bsdf, absorption = hit.bsdf(ray), 0.0 if sight is None else sight.absorption_per_mm
    upright = _brdf_upright(hit, bsdf)

    def add_emitter(*state: Any) -> tuple[Any, ...]:
        number, total = state
        light, direction, distance_mm = _light(table, number, hit.p, absorption)
        cosine = dr.dot(hit.sh_frame.n, direction)
        active = hit.is_valid() & (light > 0.0) & (cosine > 0.0)
        if rig.shadows:
            to_light = direction, distance_mm
            active &= ~shaded(scene, rig.heights, hit, to_light, active, coherent=False)
        if rig.matte:
            brdf_cos = upright * cosine
        else:
            brdf_cos = bsdf.eval(mi.BSDFContext(), hit, hit.to_local(direction), active)[0]
        weight = dr.select(active, brdf_cos * light, 0.0)
        return number + 1, total + weight * dr.gather(mi.Color3f, table.intensity, number)

    start = mi.UInt32(0), _filled(table, hit, upright)
    total = dr.while_loop(start, lambda number, _: number < table.count, add_emitter)[1]
    if rig.dots is not None:
        total *= rig.dots.factor(hit.p)
    return total if sight is None else total * sight.transmission(hit.t)


def _brdf_upright(hit: Any, bsdf: Any) -> Any:
    """Return the BRDF, 1/sr, from light incident along the normal towards the camera."""
    normal = hit.to_local(hit.sh_frame.n)
    return bsdf.eval(mi.BSDFContext(), hit, normal, hit.is_valid())[0]


def _filled(table: _Table, hit: Any, brdf: Any) -> Any:
    """Return the radiance due to the fill light, mW / (mm^2 sr).

    The fill is incident from many directions, but `brdf` is that of light along the normal. This is
    exact for a matte coat. For flakes the error is small, because the fill is uniform.
    """
    sky = dr.select(hit.is_valid(), sky_seen(hit.sh_frame.n.z, table.dark_cap) * brdf, 0.0)
    return sky * table.fill


def _light(table: _Table, number: Any, point_mm: Any, absorption: float) -> tuple[Any, Any, Any]:
    """Return the light of an emitter at a point, the direction to the emitter and its distance, mm.

    The light is the irradiance of a surface that faces the emitter, per radiant intensity along the
    emitter's aim (1/mm^2).
    """
    to_light = dr.gather(mi.Point3f, table.position_mm, number) - point_mm
    distance_mm = dr.norm(to_light)
    direction = to_light / distance_mm
    ahead = -dr.dot(direction, dr.gather(mi.Vector3f, table.aim, number))
    exponent = dr.gather(mi.Float, table.exponent, number)
    lobe = dr.select(ahead > 0.0, dr.power(dr.maximum(ahead, 1e-6), exponent), 0.0)
    light = lobe / (distance_mm * distance_mm)
    if absorption:
        light *= dr.exp(-absorption * distance_mm)
    mirrored = dr.gather(mi.Bool, table.mirrored, number)
    light *= dr.select(mirrored, mi.fresnel(direction.z, dr.rcp(table.ior))[0], 1.0)
    return light, direction, distance_mm


def trace_face(scene: Any, rig: LampRig) -> Truth:
    """Trace one ray through every pixel centre and return the true surface at its hit.

    There is no projector: projector coordinates are 0, and `lit` is True for every visible point.
    """
    width, height = rig.camera.pinhole.width_px, rig.camera.pinhole.height_px
    centres = SubPixels.of_image(width, height, 1)
    ray = rig.camera.ray(centres.x_px, centres.y_px)
    ray = ray if rig.layers is None else rig.layers.refract(ray).ray
    hit = first_hit(scene, rig.heights, ray)
    zero, visible = dr.zeros(mi.Float, width * height), hit.is_valid()
    return truth_of(rig.camera, hit, (zero, zero), visible, visible)

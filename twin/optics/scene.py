"""Mitsuba scenes: the coated face under the rig, for the one-trace and for the stock engine."""

from typing import TYPE_CHECKING, Any

import mitsuba as mi

from twin.config.models import Experiment
from twin.optics.coat import coated_mesh, coating_bsdf
from twin.optics.connection import Rig
from twin.optics.devices import Device
from twin.optics.radiometry import irradiance_at_1mm
from twin.optics.rig import true_calibration

if TYPE_CHECKING:
    import trimesh


def coated_scene(experiment: Experiment, face: "trimesh.Trimesh") -> Any:
    """Scene of the coated face alone: the coat is opaque, nothing below it is seen."""
    mesh = coated_mesh(face, coating_bsdf(experiment.coating))
    # optimize=False: since 3.7 load_dict merges shapes, which breaks later parameter updates.
    return mi.load_dict({"type": "scene", "coated_face": mesh}, optimize=False)


def rig_of(experiment: Experiment) -> Rig:
    """Devices and radiometric scale of an experiment, ready for the tracer."""
    calibration = true_calibration(experiment)
    return Rig(
        camera=Device(calibration.camera, calibration.T_world_from_cam),
        projector=Device(calibration.projector, calibration.T_world_from_proj),
        irradiance_at_1mm=irradiance_at_1mm(experiment.projector, calibration.projector),
    )

"""Render the sequence of a moving scene: a bare specimen, or a press.

This module must be imported within a `renderer_session`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twin.config.digest import seed_sequence
from twin.config.models import Experiment
from twin.config.motion import Motion
from twin.optics.checks import vibrates_fast
from twin.optics.connection import FrameLight
from twin.optics.exposures import ExposureSequence, VibratingSequence
from twin.optics.frame_times import frame_times_s, row_delay_s, sequence_ends_s
from twin.optics.light import LightTable
from twin.optics.moving_face import MovingFace
from twin.optics.moving_specimen import MovingSpecimen
from twin.optics.moving_stack import MovingStack
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack
from twin.pipeline import trace

if TYPE_CHECKING:
    from twin.mechanics.relief import FaceGrid

FaceAt = Callable[[float], "FaceGrid"]


def exposures_of(experiment: Experiment) -> ExposureSequence:
    """Return the relative times of all frames of an experiment.

    Raises
    ------
    InputError : the exposure is automatic, or does not fit in the period of its frame
    """
    times = frame_times_s(experiment)
    if vibrates_fast(experiment):
        return VibratingSequence.vibrating(times, experiment.motion.vibration)
    return ExposureSequence.of(times, sequence_ends_s(experiment), row_delay_s(experiment))


@renderer_session()
def light_moving(
    experiment: Experiment,
    geometry: trace.Geometry,
    view: trace.View,
    face_at: FaceAt,
    progress: Callable[[float], None],
) -> RadianceStack:
    """Return the radiance of all frames of a moving scene; the truth is that of the middle.

    Parameters
    ----------
    geometry, view : loaded scene, and camera and projector, in the middle of the sequence
    face_at : returns the pressed face at a time, s; not called for a bare specimen
    progress : function that is called with the finished fraction, 0 to 1
    """
    pinhole, sequence = view.rig.camera.pinhole, exposures_of(experiment)
    scene: MovingSpecimen | MovingFace = MovingFace(experiment, face_at)
    if geometry.face is None:
        motion = Motion(**experiment.motion.model_dump())
        scene = MovingSpecimen(geometry.scene, view.rig, motion, experiment.render.samples)
    tables = _tables(experiment, view, scene, sequence)
    light, size_px = FrameLight(tables), (pinhole.width_px, pinhole.height_px)
    stack = MovingStack(scene, sequence, light, size_px, experiment.render.samples)
    rng = np.random.default_rng(seed_sequence(experiment, "motion"))
    frames, accuracy = stack.frames(rng, progress)
    bounces = trace.bounces_of(experiment, geometry, None, tables)
    if bounces is not None and bounces.most and isinstance(scene, MovingSpecimen):
        indirect = scene.between_surfaces(light, sequence, bounces)
        frames = tuple(image + more for image, more in zip(frames, indirect, strict=True))
    return RadianceStack(frames, view.truth, accuracy)


def _tables(
    experiment: Experiment,
    view: trace.View,
    scene: MovingSpecimen | MovingFace,
    sequence: ExposureSequence,
) -> dict[str, LightTable]:
    """Return the light tables for all axial distances of the sequence."""
    if experiment.projector.aperture_mm:
        ranges_mm = [scene.axial_mm(sequence.time_s(place)) for place in (-1.0, 0.0, 1.0)]
        nearest_mm, farthest_mm = np.transpose(ranges_mm)
        view = replace(view, axial_mm=(float(nearest_mm.min()), float(farthest_mm.max())))
    return trace.tables_of(experiment, view)

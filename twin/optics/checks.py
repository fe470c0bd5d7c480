"""Check whether the renderer supports an experiment, before the press and the trace are run."""

from reconstruction.errors import InputError
from twin.config.instant import experiment_at
from twin.config.layers import holding_layer
from twin.config.models import Experiment
from twin.optics.frame_times import sequence_ends_s
from twin.optics.light import pattern_set
from twin.specimens import Body, bodies


def check_renderable(experiment: Experiment) -> None:
    """Raise InputError if the renderer does not support the settings of the experiment.

    The result does not depend on the shape of the pressed face.

    Raises
    ------
    InputError : depth of field with one sample per pixel; a stack of frames above 18 GB; a coat
        that is not valid in the layer around it; properties that the stock engine lacks; a bare
        specimen without material or with the stock engine; projector defocus with clear or
        polished specimens; a motion that the renderer does not support
    """
    check_samples(experiment)
    check_stack_size(experiment)
    check_motion(experiment)
    if not experiment.method.presses:
        check_direct_engine(experiment)
        parts = bodies(experiment.specimen, 0.0)
        check_materials(parts)
        if any(part.material is not None and part.material.is_sharp for part in parts):
            check_focus(experiment)
        return
    check_coat(experiment)
    if experiment.method.fringes and experiment.render.engine == "stock":
        check_stock(experiment)


# Upper limit for the Gray-code frames along one axis: 14 bits for 8192 stripes and their borders,
# and a white and a black frame.
_MOST_WORDS = 32
# The polynomial through 5 moments deviates from such a sine by at most 1 % of the amplitude.
_MOST_PERIODS = 0.5
MOST_PIXEL_VALUES = 3_000_000_000
"""Largest number of pixel values in a stack of frames: 45 megapixels in 66 frames. Each value takes
6 bytes, for radiance and digital number together."""


def check_stack_size(experiment: Experiment) -> None:
    """Raise InputError if the stack of frames takes more than 18 GB."""
    if not experiment.method.fringes:
        return
    camera, patterns = experiment.camera, experiment.patterns
    pixels = (camera.width_px // camera.binning) * (camera.height_px // camera.binning)
    shots = patterns.steps * (1 + len(patterns.further_periods_px))
    if 2 * (shots + _MOST_WORDS) * pixels <= MOST_PIXEL_VALUES:
        return  # without reading the period, so that a study over it is checked once
    frames = len(pattern_set(experiment.projector, patterns).frames)
    if frames * pixels > MOST_PIXEL_VALUES:
        raise InputError(
            f"camera.width_px, height_px, binning: found {pixels:.3g} pixels in {frames} frames, "
            f"{6e-9 * frames * pixels:.3g} GB, allowed up to {6e-9 * MOST_PIXEL_VALUES:.3g} GB; "
            "raise camera.binning, or lower patterns.steps or the pixels"
        )


def check_samples(experiment: Experiment) -> None:
    """Raise InputError for depth of field with one sample per pixel, which uses one lens point."""
    if experiment.camera.depth_of_field and experiment.render.samples == 1:
        raise InputError(
            "render.samples: found 1, allowed 4 or more with camera.depth_of_field, better 16: each"
            " sample passes one point of the lens"
        )


def check_coat(experiment: Experiment) -> None:
    """Raise InputError if the model of the coat is not valid in the clear layer around the coat."""
    holder = holding_layer(experiment.layers)
    if holder is not None:
        experiment.coating.in_medium(holder.ior)


def check_stock(experiment: Experiment) -> None:
    """Raise InputError for lens distortion, defocus or glints, which stock Mitsuba lacks."""
    if any(experiment.camera.distortion):
        raise InputError(
            "camera.distortion: stock Mitsuba cannot express it;"
            " set it to zero or use render.engine = 'one_trace'"
        )
    if experiment.projector.aperture_mm:
        raise InputError(
            "projector.aperture_mm: stock Mitsuba cannot express blur that depends on distance;"
            " set it to zero or use render.engine = 'one_trace'"
        )
    if experiment.coating.facets() is not None:
        raise InputError(
            "coating.glints: stock Mitsuba cannot express discrete flakes; remove the table or use "
            "render.engine = 'one_trace'"
        )


def check_direct_engine(experiment: Experiment) -> None:
    """Raise InputError for the stock engine with a bare specimen."""
    if experiment.render.engine != "one_trace":
        raise InputError(
            "render.engine: found 'stock', allowed 'one_trace' with modality ="
            f" '{experiment.modality}': stock"
            " Mitsuba cannot connect a projector through clear bodies; twin export writes the scene"
        )


def check_motion(experiment: Experiment) -> None:
    """Raise InputError if the specimen moves and the renderer does not support this.

    Raises
    ------
    InputError : photometric stereo; the stock engine; an automatic exposure, or one that does not
        fit in its frame; a clear or polished bare specimen; a vibration of more than one period
        with another motion or a rolling readout; a press that rolls, that slides with friction,
        that vibrates by more than half a period, or whose travel is not positive; printed dots or
        discrete flakes on its face
    """
    motion = experiment.motion
    if motion.is_stated and motion.time_s is not None and experiment.method.presses:
        raise InputError(
            f"motion.time_s: found {motion.time_s:g} with a press, allowed for a bare specimen; "
            "state the travel and place of that time (press.depth_mm, specimen.x_mm), remove "
            "[motion]"
        )
    if not motion.moves:
        return
    if not experiment.method.fringes:
        raise InputError(
            f"motion: found a motion with modality = '{experiment.modality}', which takes one "
            "image; remove [motion], or measure by fringes"
        )
    if experiment.render.engine != "one_trace":
        raise InputError(
            f"render.engine: found '{experiment.render.engine}', allowed 'one_trace' with a motion;"
            " stock Mitsuba renders scenes at rest (motion.time_s)"
        )
    ends_s = sequence_ends_s(experiment)
    if motion.encoder:
        _check_encoder(experiment)
    if not experiment.method.presses:
        _check_matt(bodies(experiment.specimen, 0.0))
        _check_vibration(experiment)
        return
    for time_s in ends_s:
        experiment_at(experiment, time_s)
    _check_moving_press(experiment)


def _check_encoder(experiment: Experiment) -> None:
    motion = experiment.motion
    turns = bool(motion.twist_deg_s or motion.roll_deg_s)
    single = experiment.patterns.stepping == "single"
    if turns or single or experiment.method.presses or experiment.layers:
        raise InputError(
            "motion.encoder: found true, allowed for a bare specimen in air that does not turn, and"
            " patterns.stepping other than 'single'; set it to false"
        )


def vibrates_fast(experiment: Experiment) -> bool:
    """Return True if a vibration has more than one period during the sequence."""
    start_s, end_s = sequence_ends_s(experiment)
    vibration = experiment.motion.vibration
    return vibration.amplitude_um > 0.0 and vibration.frequency_hz * (end_s - start_s) > 1.0


def _check_vibration(experiment: Experiment) -> None:
    alone = experiment.motion.only_vibrates and experiment.timing.readout == "global"
    if vibrates_fast(experiment) and not alone:
        frequency_hz = experiment.motion.vibration.frequency_hz
        raise InputError(
            f"motion.vibration.frequency_hz: found {frequency_hz:g}, more than one period during "
            "the sequence, allowed as the only motion with a global readout; lower it, or remove "
            "the other motions and set timing.readout = 'global'"
        )


def _check_moving_press(experiment: Experiment) -> None:
    motion, remedy = experiment.motion, "measure a bare specimen (modality = 'direct_fpp')"
    if motion.roll_deg_s:
        raise InputError(
            f"motion.roll_deg_s: found {motion.roll_deg_s:g}, allowed 0 of a press; {remedy}"
        )
    start_s, end_s = sequence_ends_s(experiment)
    periods = motion.vibration.frequency_hz * (end_s - start_s)
    if motion.vibration.amplitude_um and periods > _MOST_PERIODS:
        raise InputError(
            f"motion.vibration.frequency_hz: found {motion.vibration.frequency_hz:g}, {periods:.3g}"
            f" periods during the sequence, allowed up to {_MOST_PERIODS:g} of a press, which is "
            f"pressed at 5 moments; lower it, or {remedy}"
        )
    along = motion.vibration.amplitude_um > 0.0 and motion.vibration.direction != "z"
    slides = motion.x_mm_s or motion.y_mm_s or motion.twist_deg_s or along
    if slides and experiment.elastomer.sticks:
        raise InputError(
            "motion: found a specimen that slides or twists under an elastomer with friction, "
            "allowed motion along z; set elastomer.friction = 'none', or move along z only"
        )
    if experiment.timing.readout == "rolling":
        raise InputError(
            "timing.readout: found 'rolling', allowed 'global' for a moving press: each row would "
            f"need its own press; use 'global', or {remedy}"
        )
    if experiment.coating.facets() is not None:
        raise InputError(
            "coating.glints: found discrete flakes on a moving face, allowed a smooth coat; remove "
            "[coating.glints], or the motion"
        )
    if experiment.photometric.markers is not None:
        raise InputError(
            "photometric.markers: found printed dots on a moving face, allowed a coat without dots:"
            " their edges are not computed between the presses; remove [photometric.markers], or "
            "the motion"
        )
    if experiment.bounces:
        raise InputError(
            f"render.bounces: found {experiment.bounces}, allowed 0 for a moving press; set it to 0"
        )


def _check_matt(parts: tuple[Body, ...]) -> None:
    sharp = [part.name for part in parts if part.material is not None and part.material.is_sharp]
    if sharp:
        raise InputError(
            f"motion: found a clear or polished material of {', '.join(sharp)}, allowed matt or "
            "rough ones: photons are traced for a scene at rest; use a rougher material, or "
            "motion.time_s"
        )


def check_materials(parts: tuple[Body, ...]) -> None:
    """Raise InputError if a part of a bare specimen has no material."""
    bare = [part.name for part in parts if part.material is None]
    if bare:
        raise InputError(
            f"specimen.material: found none for {', '.join(bare)}; modality = 'direct_fpp' images"
            " the bare specimen: add [specimen.material] with use = 'materials/metals/steel'"
        )


def check_focus(experiment: Experiment) -> None:
    """Raise InputError for projector defocus; call for clear or polished specimens only."""
    aperture_mm = experiment.projector.aperture_mm
    if aperture_mm:
        raise InputError(
            f"projector.aperture_mm: found {aperture_mm:g}, allowed 0 with clear or polished"
            " specimens: their light is traced with one blur; put it into projector.blur_px"
        )

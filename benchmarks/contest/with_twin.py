"""The work of the comparison by this project."""

from collections.abc import Callable

import numpy as np

from benchmarks.contest.child import Arrays


def decode(inputs: Arrays) -> Callable[[], Arrays]:
    """Decode phase and Gray code frames to projector coordinates, with standard deviations."""
    from benchmarks.decode import SENSOR
    from reconstruction.decoding.decode import DecodeOptions
    from reconstruction.decoding.decode import decode as decode_stack
    from reconstruction.patterns import PatternSet

    patterns, stack = PatternSet(1280, 720), inputs["phase_gray"]

    def decoded_px(options: DecodeOptions) -> np.ndarray:
        decoded = decode_stack(stack, patterns, SENSOR, options)
        both = decoded.column, decoded.row
        coordinates_px = np.stack([axis.coordinate_px for axis in both], axis=-1)
        return np.where(decoded.valid[..., None], coordinates_px, np.nan)

    unfiltered_px = decoded_px(DecodeOptions(filter_taps=0))
    return lambda: {"px": decoded_px(DecodeOptions()), "unfiltered_px": unfiltered_px}


def tactile(inputs: Arrays) -> Callable[[], Arrays]:
    """Press each ball into the gel and render its image; the first image is without contact."""
    from benchmarks.gelsight import SENSORS, WIDE_PAD
    from benchmarks.real_presses import FIRST_TWIN, case_of, read_presses
    from reconstruction.photometric.images import mean_background
    from twin.config import load_experiment
    from twin.optics.backed_coat import seen_face
    from twin.pipeline import press_specimen
    from twin.pipeline.colours import calibrated_sensor

    few = {"photometric.presses.count": 16}  # its calibration is not used here
    experiment = load_experiment("examples/gelsight_ball", few | WIDE_PAD)
    sensor = calibrated_sensor(experiment, SENSORS)[0]
    cases = [case_of(experiment, press) for press in read_presses().presses]
    still = mean_background(sensor.backgrounds())

    def action() -> Arrays:
        images = [still]
        for number in inputs["presses"]:
            face = seen_face(cases[number], press_specimen(cases[number]))
            images.append(sensor.image(face, FIRST_TWIN + int(number)).astype(np.float64))
        return {"images": np.array([images])}

    return action


def press(inputs: Arrays) -> Callable[[], Arrays]:
    """Press a ball into a bonded layer, to a depth."""
    from benchmarks.mechanics import elastomer, to_depth
    from twin.mechanics import press as press_elastomer
    from twin.specimens.kinds.ball import Ball

    ball = Ball(diameter_mm=2.0 * float(inputs["radius_mm"]))
    side_mm, cells = float(inputs["side_mm"]), int(inputs["cells"])
    sides = {"length_x_mm": side_mm, "length_y_mm": side_mm}
    layer = {"thickness_mm": float(inputs["thickness_mm"]), "poisson_ratio": float(inputs["nu"])}
    pad = elastomer("contact_face", **sides, **layer)
    load = to_depth(float(inputs["depth_mm"]), side_mm / cells)
    # The modulus of `elastomer` is 1 MPa, so that newtons are mm^2.
    return lambda: {"force_mm2": np.array(press_elastomer(ball, pad, load).force_n)}


def frame(inputs: Arrays) -> Callable[[], Arrays]:
    """Render all frames of the sequence by one trace; return the requested frame."""
    from benchmarks.contest.work import frame_case

    case, index = frame_case(), int(inputs["index"])
    return lambda: {"radiance": np.asarray(case.trace()[index])}

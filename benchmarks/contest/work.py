"""The four pieces of work: their inputs, as arrays for a file, and the errors of a result."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.contest.child import Arrays
from benchmarks.decode import AMPLITUDE_DN, MEAN_DN, SENSOR, frames_at, rig, surface
from benchmarks.photometric_balls import PITCH_MM
from benchmarks.real_presses import HEIGHT_PX, WIDTH_PX, circle_of, read_presses, spots_of
from reconstruction.patterns import PatternSet

PROJECTOR = 1280, 720
# Periods per 1280 px and steps of `fringes`: its finest period is that of this project, 18 px.
FRINGES, STEPS = (71.0, 70.0, 63.0), 9
GROSS_PX = 2.0
FRAME_BINNING, FRAME = 4, 3
TAXIM_SHAPE = 480, 640  # twice the pixels of the images of real presses


@dataclass(frozen=True)
class PeerTask:
    """One piece of work.

    Attributes
    ----------
    name : function of the modules `with_...`
    error : what the error is, with its unit
    inputs : makes the arrays, given a folder for further files and whether to be quick
    error_of : error of a result, and a note on it; given the inputs
    """

    name: str
    error: str
    inputs: Callable[[Path, bool], Arrays]
    error_of: Callable[[Arrays, Arrays], tuple[float, str]]

    def results_in(self, result: Arrays) -> int:
        """Return the number of results that a timed action computed: images of presses, else 1.

        The first image of each mirror is without contact; it is computed before the action.
        """
        images = result.get("images")
        return 1 if images is None else images.shape[0] * (images.shape[1] - 1)


# ---- decode --------------------------------------------------------------------------------------


def decode_inputs(folder: Path, quick: bool) -> Arrays:
    """Return the noisy stacks of three codes of one curved coat, and its projector coordinates."""
    rows, cols = (183, 242) if quick else (366, 484)
    truth_px = surface(rig(rows, cols))[1]
    patterns, rng = PatternSet(*PROJECTOR), np.random.default_rng(11)

    def noisy(frames: np.ndarray, gain: float = 1.0) -> np.ndarray:
        sigma_dn = np.sqrt(SENSOR.variance_dn2(MEAN_DN))
        return np.rint(gain * (frames + rng.normal(0.0, sigma_dn, frames.shape)))

    return {
        "truth_px": truth_px,
        "phase_gray": noisy(frames_at(patterns, truth_px, MEAN_DN, AMPLITUDE_DN)).astype(np.uint16),
        "phases": noisy(phase_frames(truth_px)).astype(np.uint16),
        # Both decoders of Gray code take 8 bits.
        "gray": noisy(gray_frames(truth_px), 1 / 16).astype(np.uint8),
        "fringes": np.array(FRINGES),
        "steps": np.array(STEPS),
    }


def phase_frames(projector_px: np.ndarray) -> np.ndarray:
    """Return the frames of `fringes` for its offset p0 = pi: column first, then the row."""
    periods_px = PROJECTOR[0] / np.array(FRINGES)
    shift = 2.0 * np.pi * np.arange(STEPS) / STEPS
    phase = 2.0 * np.pi * projector_px[..., np.newaxis] / periods_px
    signal = -np.cos(phase[..., np.newaxis] - shift)  # (row, col, axis, period, step)
    frames = np.moveaxis(signal, (2, 3, 4), (0, 1, 2)).reshape(-1, *projector_px.shape[:2])
    return MEAN_DN + AMPLITUDE_DN * frames


def gray_frames(projector_px: np.ndarray) -> np.ndarray:
    """Return Gray code of columns and rows, each bit with its inverse, then white and black."""
    signs = []
    for axis, length in enumerate(PROJECTOR):
        whole = np.clip(np.rint(projector_px[..., axis]), 0, length - 1).astype(np.int64)
        gray = whole ^ (whole >> 1)
        for bit in reversed(range((length - 1).bit_length())):
            sign = 2.0 * ((gray >> bit) & 1) - 1.0
            signs += [sign, -sign]
    white = np.ones(projector_px.shape[:2])
    return MEAN_DN + AMPLITUDE_DN * np.array([*signs, white, -white])


def decode_error(inputs: Arrays, result: Arrays) -> tuple[float, str]:
    """Return the RMS error of the coordinates without gross errors, px."""
    rms_px, valid, gross = _decoded(result["px"], inputs["truth_px"])
    remarks = ["all pixels decoded"]
    if valid < 1.0 or gross > 0.0:
        remarks = [f"{valid:.1%} of the pixels decoded, {gross:.2%} gross errors"]
    if "unfiltered_px" in result:
        unfiltered = _decoded(result["unfiltered_px"], inputs["truth_px"])
        remarks.append(f"error without filter {unfiltered[0]:.2g} px")
    return rms_px, "; ".join(remarks)


def _decoded(decoded_px: np.ndarray, truth_px: np.ndarray) -> tuple[float, float, float]:
    """Return RMS error without gross errors, share of decoded pixels, and of gross errors."""
    error_px = decoded_px - truth_px
    valid = np.isfinite(error_px).all(axis=-1)
    gross = (np.abs(error_px) > GROSS_PX).any(axis=-1) & valid
    fine = error_px[valid & ~gross]
    rms_px = float(np.sqrt(np.mean(fine**2))) if fine.size else float("nan")
    return rms_px, float(valid.mean()), float(gross.mean())


# ---- tactile image -------------------------------------------------------------------------------


def tactile_inputs(folder: Path, quick: bool) -> Arrays:
    """Return height maps of the balls of real presses in four mirror images, mm, and their depths.

    The orientation of the other program's calibration is not stated.
    """
    real = read_presses()
    chosen = range(0, len(real.presses), 32 if quick else 10)
    rows, cols = TAXIM_SHAPE
    pitch_mm = PITCH_MM * WIDTH_PX / cols
    x_mm, y_mm = ((np.arange(n) - (n - 1) / 2) * pitch_mm for n in (cols, rows))
    heights = []
    for number in chosen:
        press = real.presses[number]
        radius_mm = press.ball_mm / 2
        square = (x_mm - press.x_mm) ** 2 + (y_mm[:, None] + press.y_mm) ** 2
        heights.append(radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0.0)))
    return {
        "presses": np.array(chosen),
        "pitch_mm": np.array(pitch_mm),
        "heights_mm": np.array([mirrored(np.array(heights), k) for k in range(4)], np.float32),
        "depths_mm": np.array([real.presses[number].depth_mm for number in chosen]),
    }


def mirrored(images: np.ndarray, number: int) -> np.ndarray:
    """Return one of the four mirror images of images, (image, row, col, ...); its own inverse."""
    rows, cols = (slice(None, None, -1 if number & bit else 1) for bit in (1, 2))
    return images[:, rows, cols]


def tactile_error(inputs: Arrays, result: Arrays) -> tuple[float, str]:
    """Return the RMS error of the change of levels on the spots of the real contacts, best mirror.

    `images` of the result are (mirror, image, row, col, channel), the first without contact.
    """
    errors = [
        _change_error(inputs["presses"], mirrored(images, number)[..., channels])
        for number, images in enumerate(result["images"])
        for channels in ([0, 1, 2], [2, 1, 0])
    ]
    return min(errors), ""


def _change_error(presses: np.ndarray, images: np.ndarray) -> float:
    real, off = read_presses(), []
    step = images.shape[1] // HEIGHT_PX
    still, *pressed = images[:, ::step, ::step]
    for number, image in zip(presses, pressed, strict=True):
        circle = circle_of(real.presses[number])
        change = spots_of(image, circle)[1] - spots_of(still, circle)[1]
        off.append(change - real.change[real.of_press == number])
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


# ---- press ---------------------------------------------------------------------------------------


def press_inputs(folder: Path, quick: bool) -> Arrays:
    """Return a ball of 4 mm on a bonded layer of 4 mm, nearly incompressible, and its force."""
    from tests.oracles.fredholm import press_ball

    given = {"radius_mm": 4.0, "depth_mm": 0.6, "thickness_mm": 4.0, "nu": 0.49}
    truth = press_ball(*given.values()).force_over_modulus_mm2
    grid = {"side_mm": 28.0, "cells": 256 if quick else 512, "truth_mm2": truth}
    return {name: np.array(value) for name, value in (given | grid).items()}


def press_error(inputs: Arrays, result: Arrays) -> tuple[float, str]:
    """Return the relative error of the force, %."""
    return 100.0 * abs(float(result["force_mm2"] / inputs["truth_mm2"]) - 1.0), ""


# ---- frame ---------------------------------------------------------------------------------------


@cache
def frame_case() -> Any:
    """Return two balls under the coated slab, ready to be traced."""
    from benchmarks.stack import StackCase
    from twin.optics.session import activate

    activate()
    return StackCase.of_film(FRAME_BINNING)


def frame_inputs(folder: Path, quick: bool) -> Arrays:
    """Return mesh, camera and projector of a frame, and its converged image by stock Mitsuba."""
    case = frame_case()
    from twin.optics.rig import field_of_view_deg, perspective_sensor, to_world

    mesh = folder / "face.ply"
    mesh.write_bytes(case.face.export(file_type="ply", vertex_normal=True))
    camera, projector = case.rig.camera, case.rig.projector
    sensor = perspective_sensor(camera.pinhole, camera.T_world_from_device, case.samples)
    texture, canvas = case.texture(FRAME)
    given = {
        "mesh": np.array(str(mesh)),
        "bsdf": np.array(json.dumps(case.experiment.coating.bsdf())),
        "sensor": np.array(json.dumps(sensor | {"to_world": None})),
        "camera_to_world": to_world(camera.T_world_from_device),
        "projector_to_world": to_world(projector.T_world_from_device),
        "canvas": texture,
        "canvas_fov_deg": np.array(
            field_of_view_deg(2 * canvas.half_width_px, projector.pinhole.fx_px)
        ),
        "scale": np.array(case.rig.irradiance_at_1mm / np.pi),
        "index": np.array(FRAME),
    }
    return given | {"truth": converged(given, 64 if quick else 512)}


def converged(given: Arrays, samples: int) -> np.ndarray:
    """Return the frame by stock Mitsuba with so many rays per pixel."""
    from benchmarks.contest import with_mitsuba

    sensor = json.loads(str(given["sensor"]))
    sensor["sampler"]["sample_count"] = samples
    return with_mitsuba.frame(given | {"sensor": np.array(json.dumps(sensor))})()["radiance"]


def frame_error(inputs: Arrays, result: Arrays) -> tuple[float, str]:
    """Return the RMS error over the mean radiance of the lit pixels, %; in the note the median."""
    truth = inputs["truth"]
    lit = truth > 0.05 * truth.max()
    error = 100.0 * (result["radiance"] - truth)[lit] / truth[lit].mean()
    return float(np.sqrt(np.mean(error**2))), f"median {np.median(np.abs(error)):.2g} %"


WORKS = (
    PeerTask("decode", "RMS of the projector coordinate, px", decode_inputs, decode_error),
    PeerTask("tactile", "RMS of the change by contact, levels", tactile_inputs, tactile_error),
    PeerTask("press", "force, %", press_inputs, press_error),
    PeerTask("frame", "RMS over mean radiance, %", frame_inputs, frame_error),
)

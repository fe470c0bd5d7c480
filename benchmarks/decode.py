"""Time a full capture from camera frames to points.

A curved coat is projected exactly through a camera and an off-axis projector with distortion; the
53 noisy frames are 16-bit. Timed: decoding with filter, masks, order, sigma, residual and order
error, plus triangulation. In turns with it, so that all use the same machine: a copy of the stack,
and a plain OpenCV phase of the phase frames (accumulate, cartToPolar). `peers` compares it with
other decoders. The last line of the output is one JSON object.

peak_over_stack: most resident memory while decoding and triangulating, less that before the stack
was loaded, over the bytes of the stack, which itself counts as 1. Linux only, otherwise null.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks._harness import in_turns, print_figures, quick_parser, resident_bytes, seconds
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.patterns import AXES, PatternSet
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import PointMap, triangulate

FULL, QUICK, REPEATS = (1464, 1936), (366, 484), 7
MEAN_DN, AMPLITUDE_DN = 1900.0, 1500.0
SENSOR = SensorNoise(gain_dn_per_e=0.17, read_noise_e=6.2, black_level_dn=64, saturation_dn=4095)


def rig(rows: int, cols: int) -> Calibration:
    """Return a camera 214 mm above the coat and a projector tilted by 30 degrees."""
    f_px = 50.0 / 0.0045 * cols / FULL[1]
    lens = (-0.05, 0.1, 1e-4, -1e-4, 0.0)
    camera = Pinhole(cols, rows, f_px, f_px, (cols - 1) / 2, (rows - 1) / 2, lens)
    projector = Pinhole(1280, 720, 1536.0, 1536.0, 639.5, 719.5, (-0.02, 0.01, 1e-4, 2e-4, 0.0))
    tilt = np.radians(30.0)
    # The optical axis passes the lower image edge, half an image from the centre.
    place = 250.0 * np.array([np.sin(tilt), -0.234, np.cos(tilt)])
    above = looking_at(np.array([0.0, 0.0, 214.0]), 0.0)
    return Calibration(camera, projector, above, looking_at(place, tilt))


def looking_at(position_mm: np.ndarray, tilt_rad: float) -> np.ndarray:
    """Return T_world_from_dev of a device that looks down, turned about world y."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, 0.0, -s], [0.0, -1.0, 0.0], [-s, 0.0, -c]])
    T[:3, 3] = position_mm
    return T


def surface(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return the point of every camera pixel, (row, col, xyz) mm, and its projector pixel."""
    camera = calibration.camera
    pixel = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), axis=-1)
    ray = np.concatenate([camera.unproject(pixel), np.ones((*pixel.shape[:2], 1))], axis=-1)
    height_mm = np.exp(-(ray[..., :1] ** 2 + ray[..., 1:2] ** 2) * (214.0 / 6.0) ** 2)
    points = ray * (214.0 - height_mm) @ calibration.T_world_from_cam[:3, :3].T
    points += calibration.T_world_from_cam[:3, 3]
    T = np.linalg.inv(calibration.T_world_from_proj)
    return points, calibration.projector.project(points @ T[:3, :3].T + T[:3, 3])


def frames_at(
    patterns: PatternSet, projector_px: np.ndarray, mean_dn: float, amplitude_dn: float
) -> np.ndarray:
    """Return noise-free frames, (frame, row, col) float32 DN, at (row, col, uv) coordinates."""
    stack = np.zeros((len(patterns.frames), *projector_px.shape[:2]), np.float32)
    for i, frame in enumerate(patterns.frames):
        x_px = projector_px[..., 1 if frame.axis == "row" else 0]
        if frame.kind == "phase":
            period_px, shift = patterns.phase_of(frame)
            signal = np.cos(2.0 * np.pi * (x_px / period_px + shift))
        else:
            levels = patterns.profile(frame) / 127.5 - 1.0
            signal = levels[np.clip(np.rint(x_px).astype(np.intp), 0, levels.size - 1)]
        stack[i] = mean_dn + amplitude_dn * signal
    return stack


def synthesise(patterns: PatternSet, projector_px: np.ndarray) -> np.ndarray:
    """Return the noisy stack, (frame, row, col) uint16 DN."""
    rng = np.random.default_rng(7)
    noise_dn = rng.normal(0.0, np.sqrt(SENSOR.variance_dn2(MEAN_DN)), (4, *projector_px.shape[:2]))
    noise_dn = noise_dn.astype(np.float32)
    stack = frames_at(patterns, projector_px, MEAN_DN, AMPLITUDE_DN)
    for i, frame in enumerate(stack):
        # Four noise fields, shifted: drawing 53 would need most of the run time.
        frame += np.roll(noise_dn[i % 4], 37 * i, axis=1)
    return np.rint(stack).astype(np.uint16)


def opencv_phase(stack: np.ndarray, patterns: PatternSet) -> list[np.ndarray]:
    """Return wrapped phase and modulation of both axes by a few lines of OpenCV."""
    results = []
    for axis in AXES:
        real, imag = (np.zeros(stack.shape[1:], np.float32) for _ in range(2))
        for n, frame in enumerate(stack[patterns.index("phase", axis)]):
            angle = 2.0 * np.pi * n / patterns.steps
            level = frame.astype(np.float32)
            cv2.scaleAdd(level, np.cos(angle), real, real)
            cv2.scaleAdd(level, -np.sin(angle), imag, imag)
        results += cv2.cartToPolar(real, imag)
    return results


def ideal_rms_px(seed: int = 3) -> dict[str, float]:
    """Return the error of noise-free frames at random coordinates, float and 8-bit, unfiltered."""
    patterns, rng = PatternSet(1280, 720), np.random.default_rng(seed)
    projector_px = np.stack([rng.uniform(0, 1279, (200, 500)), rng.uniform(0, 719, (200, 500))], -1)
    clean = frames_at(patterns, projector_px, 120.0, 100.0)
    sensor = SensorNoise(0.0, 0.0, 0.0, 255.0)
    stacks = {"float": clean.astype(np.float32), "eight_bit": np.rint(clean).astype(np.uint8)}
    errors = {}
    for name, stack in stacks.items():
        decoded = decode(stack, patterns, sensor, DecodeOptions(filter_taps=0))
        error_px = np.stack([decoded.column.coordinate_px, decoded.row.coordinate_px], -1)
        error_px = (error_px - projector_px)[decoded.valid]
        errors[f"{name}_rms_px"] = float(np.sqrt(np.mean(error_px**2)))
    return errors


def peak_over_stack(stack: np.ndarray) -> float | None:
    """Return the peak memory of stack and results, in stacks.

    A process of its own measures it: here, memory of earlier results would be reused, not counted.
    """
    if not Path("/proc/self/status").exists():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stack.npy"
        np.save(path, stack)
        command = [sys.executable, __file__, "--peak-of", str(path)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout)


def print_peak(path: Path) -> None:
    """Print the growth of this process from before the stack is loaded to its peak, in stacks."""
    patterns = PatternSet(1280, 720)
    small = np.zeros((len(patterns.frames), 24, 32), np.uint16)
    triangulate(decode(small, patterns, SENSOR), rig(24, 32))  # loads the kernels
    before_bytes = resident_bytes("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # resets the peak
    stack = np.load(path)
    points = triangulate(decode(stack, patterns, SENSOR), rig(*stack.shape[1:]))
    assert points.valid.any()
    print(round((resident_bytes("VmHWM") - before_bytes) / stack.nbytes, 3))


def measure(rows: int, cols: int) -> dict[str, object]:
    """Return all figures at one image size."""
    patterns, calibration = PatternSet(1280, 720), rig(rows, cols)
    print(f"synthesising {len(patterns.frames)} frames of {cols} x {rows} px", flush=True)
    truth_mm, projector_px = surface(calibration)
    stack = synthesise(patterns, projector_px)

    def reconstruct() -> PointMap:
        return triangulate(decode(stack, patterns, SENSOR), calibration)

    print(f"compiling or loading the kernels, then {REPEATS} rounds", flush=True)
    first_s = seconds(reconstruct)
    target = np.zeros_like(stack)
    actions: dict[str, Callable[[], object]] = {
        "decode_s": reconstruct,
        "decode_only_s": lambda: decode(stack, patterns, SENSOR),
        "memcpy_s": lambda: np.copyto(target, stack),
        "opencv_phase_s": lambda: opencv_phase(stack, patterns),
    }
    # The least times, since other programs only add time.
    turns = in_turns(actions, REPEATS)
    best = {name: min(turn[name] for turn in turns) for name in actions}
    # On a busy machine the processor time remains comparable.
    start = time.process_time()
    points = reconstruct()
    cpu_s = time.process_time() - start
    error_um = 1e3 * (points.points_world_mm - truth_mm)[points.valid][:, 2]
    return {
        **best,
        "over_memcpy": best["decode_s"] / best["memcpy_s"],
        **ideal_rms_px(),
        "peak_over_stack": peak_over_stack(stack),
        **{"frames": len(patterns.frames), "rows": rows, "cols": cols, "cpu_s": cpu_s},
        "first_call_s": first_s,
        "valid": float(points.valid.mean()),
        "z_rms_um": float(np.sqrt(np.mean(error_um**2))),
        "sigma_z_um": 1e3 * float(np.median(points.sigma_z_mm[points.valid])),
    }


def main() -> None:
    parser = quick_parser(__doc__, "484 x 366 px instead of 1936 x 1464")
    parser.add_argument("--peak-of", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.peak_of:
        print_peak(arguments.peak_of)
    else:
        print_figures(measure(*(QUICK if arguments.quick else FULL)))


if __name__ == "__main__":
    main()

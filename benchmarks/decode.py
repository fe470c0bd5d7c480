"""Time a full capture from camera frames to points: `python benchmarks/decode.py [--quick]`.

A curved coat is projected exactly through a camera and an off-axis projector with distortion; the
53 noisy frames are 16-bit. The last line of the output is one JSON object.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np

from reconstruction.calibration import Calibration, Pinhole
from reconstruction.decode import decode
from reconstruction.patterns import PatternSet
from reconstruction.sensor import SensorNoise
from reconstruction.triangulate import triangulate

FULL = (1464, 1936)
QUICK = (366, 484)
REPEATS = 7
MEAN_DN, AMPLITUDE_DN = 1900.0, 1500.0
SENSOR = SensorNoise(gain_dn_per_e=0.17, read_noise_e=6.2, black_level_dn=64, saturation_dn=4095)


def rig(rows: int, cols: int) -> Calibration:
    """Return a camera 214 mm above the coat and a projector tilted by 30 degrees."""
    f_px = 50.0 / 0.0045 * cols / FULL[1]
    lens = (-0.05, 0.1, 1e-4, -1e-4, 0.0)
    camera = Pinhole(cols, rows, f_px, f_px, (cols - 1) / 2, (rows - 1) / 2, lens)
    projector = Pinhole(1280, 720, 1536.0, 1536.0, 639.5, 719.5, (-0.02, 0.01, 1e-4, 2e-4, 0.0))
    tilt = np.radians(30.0)
    return Calibration(
        camera,
        projector,
        looking_at(np.array([0.0, 0.0, 214.0]), 0.0),
        # The optical axis leaves through the lower image edge: half an image aside.
        looking_at(250.0 * np.array([np.sin(tilt), -0.234, np.cos(tilt)]), tilt),
    )


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


def synthesise(patterns: PatternSet, projector_px: np.ndarray) -> np.ndarray:
    """Return the noisy stack, (frame, row, col) uint16 DN."""
    rng = np.random.default_rng(7)
    noise_dn = rng.normal(0.0, np.sqrt(SENSOR.variance_dn2(MEAN_DN)), (4, *projector_px.shape[:2]))
    noise_dn = noise_dn.astype(np.float32)
    stack = np.zeros((len(patterns.frames), *projector_px.shape[:2]), np.uint16)
    for i, frame in enumerate(patterns.frames):
        x_px = projector_px[..., 1 if frame.axis == "row" else 0]
        if frame.kind == "phase":
            turns = x_px / patterns.period_px + frame.index / patterns.steps
            signal = np.cos(2.0 * np.pi * turns)
        else:
            levels = patterns.profile(frame) / 127.5 - 1.0
            signal = levels[np.clip(np.rint(x_px).astype(np.intp), 0, levels.size - 1)]
        # Four noise fields, shifted: drawing 53 would take longer than all the rest.
        noise = np.roll(noise_dn[i % 4], 37 * i, axis=1)
        stack[i] = np.rint(MEAN_DN + AMPLITUDE_DN * signal + noise)
    return stack


def median_s(action: Callable[[], object], repeats: int) -> float:
    """Return the median time of `repeats` calls, seconds."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="484 x 366 px instead of 1936 x 1464")
    rows, cols = QUICK if parser.parse_args().quick else FULL
    patterns, calibration = PatternSet(1280, 720), rig(rows, cols)
    print(f"synthesising {len(patterns.frames)} frames of {cols} x {rows} px", flush=True)
    truth_mm, projector_px = surface(calibration)
    stack = synthesise(patterns, projector_px)

    print("compiling or loading the kernels", flush=True)
    start = time.perf_counter()
    points = triangulate(decode(stack, patterns, SENSOR), calibration)
    first_s = time.perf_counter() - start
    error_um = 1e3 * (points.points_world_mm - truth_mm)[points.valid][:, 2]

    print(f"timing {REPEATS} repeats", flush=True)
    decode_s = median_s(lambda: triangulate(decode(stack, patterns, SENSOR), calibration), REPEATS)
    # On a busy machine the processor time tells what an idle one would need.
    start = time.process_time()
    triangulate(decode(stack, patterns, SENSOR), calibration)
    cpu_s = time.process_time() - start
    target = np.zeros_like(stack)
    memcpy_s = median_s(lambda: np.copyto(target, stack), REPEATS)
    result = {
        "decode_s": round(decode_s, 4),
        "over_memcpy": round(decode_s / memcpy_s, 2),
        "frames": len(patterns.frames),
        "rows": rows,
        "cols": cols,
        "cpu_s": round(cpu_s, 4),
        "memcpy_s": round(memcpy_s, 4),
        "first_call_s": round(first_s, 2),
        "valid": round(float(points.valid.mean()), 4),
        "z_rms_um": round(float(np.sqrt(np.mean(error_um**2))), 3),
        "sigma_z_um": round(1e3 * float(np.median(points.sigma_z_mm[points.valid])), 3),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()

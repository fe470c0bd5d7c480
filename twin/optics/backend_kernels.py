"""Test kernels of a backend; `twin.optics.backend.probe` runs them in a child process."""

import ctypes
import os
import sys
from typing import Any

from twin.optics.backend import LLVM_VARIANT


def run_kernels(variant: str) -> None:
    """Compile and run small kernels like those of the renderer; print the backend's version."""
    _leave_no_core_file()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    _check_arithmetic(dr, mi)
    _check_rendering(dr, mi)
    sys.stdout.write(f"\nbackend version {_version(variant, dr)}\n")


def _leave_no_core_file() -> None:
    try:
        import resource
    except ImportError:  # Windows writes no core files
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _check_arithmetic(dr: Any, mi: Any) -> None:
    index = dr.arange(mi.UInt32, 64)
    table = dr.arange(mi.Float, 64)
    dr.make_opaque(index, table)
    picked = dr.minimum(dr.maximum(dr.gather(mi.Float, table, 63 - index), 10), 20)
    precise = dr.maximum(mi.Float64(picked), 12) + dr.abs(dr.minimum(mi.Float64(picked), 11))
    sums = dr.zeros(mi.Float, 2)
    dr.scatter_add(sums, picked, index & 1)
    wave = dr.square(dr.sin(table)) + dr.square(dr.cos(table))
    dr.eval(picked, precise, sums, wave)
    expected = [float(min(max(number, 10), 20)) for number in range(64)]
    good = (
        sum(picked.numpy()) == sum(expected)
        and sum(precise.numpy()) == sum(max(x, 12) + min(x, 11) for x in expected)
        and sum(sums.numpy()) == sum(expected)
        and max(abs(wave.numpy() - 1)) < 1e-5
    )
    if not good:
        raise ArithmeticError("a kernel gave wrong numbers")


def _check_rendering(dr: Any, mi: Any) -> None:
    coat = {"type": "roughconductor", "alpha": 0.3}
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "blendbsdf", "weight": 0.3, "a": {"type": "diffuse"}, "b": coat},
            },
            "floor": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, -3, 0])},
            "lamp": {"type": "point", "position": [2.0, 3.0, 5.0], "intensity": 10.0},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "integrator": {"type": "direct"},
        }
    )
    column = dr.arange(mi.Float, 16) / 4 - 2
    ray = mi.Ray3f(mi.Point3f(column, 0, 5), mi.Vector3f(0, 0, -1))
    hit = scene.ray_intersect(ray)
    depth = dr.select(hit.is_valid(), hit.t, 0)
    brightness = dr.sum(mi.render(scene, spp=4).array)
    # Distance to the ball of radius 1: 5 - sqrt(1 - x^2).
    good = abs(depth.numpy()[8] - 4) < 1e-5 and depth.numpy()[0] == 0 and brightness.numpy() > 0
    if not good:
        raise ArithmeticError("a render gave wrong numbers")


def _version(variant: str, dr: Any) -> str:
    if variant == LLVM_VARIANT:
        return ".".join(str(part) for part in dr.detail.llvm_version())
    number = ctypes.c_int(0)
    ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1")).cuDriverGetVersion(
        ctypes.byref(number)
    )
    return f"{number.value // 1000}.{number.value % 1000 // 10}"


if __name__ == "__main__":
    run_kernels(sys.argv[1])

"""Tactile images by `taxim` (JAX on the processor) with its calibration of a GelSight Mini."""

import os
from collections.abc import Callable

import numpy as np

from benchmarks.contest.child import Arrays


def tactile(inputs: Arrays) -> Callable[[], Arrays]:
    """Render each height map with shadows; the first image of each mirror is without contact."""
    os.environ["JAX_PLATFORMS"] = "cpu"
    from taxim import CALIB_GELSIGHT_MINI, Taxim

    pitch = {"sensor": {"pixmm": float(inputs["pitch_mm"])}}
    peer = Taxim(CALIB_GELSIGHT_MINI, params=pitch, backend="jax", device="cpu")
    mirrors, depths_mm = inputs["heights_mm"], inputs["depths_mm"].tolist()
    still = peer.render(np.full(mirrors.shape[-2:], 10.0, np.float32))

    def rendered(maps: np.ndarray) -> list[np.ndarray]:
        pressed = zip(maps, depths_mm, strict=True)
        contacts = [peer.render(map_mm, press_depth=depth_mm) for map_mm, depth_mm in pressed]
        return [still, *contacts]

    return lambda: {"images": 255.0 * np.array([rendered(maps) for maps in mirrors], np.float32)}

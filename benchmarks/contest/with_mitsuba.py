"""One frame by stock Mitsuba: its projector has no offset, so that its canvas is larger."""

import json
from collections.abc import Callable
from itertools import count
from typing import Any

import mitsuba as mi
import numpy as np

from benchmarks.contest.child import Arrays


def frame(inputs: Arrays) -> Callable[[], Arrays]:
    """Render one frame with the emitter `projector` and the integrator `direct`."""
    mi.set_variant("llvm_ad_mono")
    emitter = {
        "type": "projector",
        "to_world": mi.ScalarTransform4f(inputs["projector_to_world"]),
        "fov": float(inputs["canvas_fov_deg"]),
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(inputs["canvas"][..., np.newaxis]),
            "raw": True,
        },
        "scale": float(inputs["scale"]),
    }
    return rendering(mi.load_dict(scene_dict(inputs) | {"emitter": emitter}))


def scene_dict(inputs: Arrays) -> dict[str, Any]:
    """Return mesh with its coat, camera and integrator."""
    sensor = json.loads(str(inputs["sensor"]))
    sensor["to_world"] = mi.ScalarTransform4f(inputs["camera_to_world"])
    coat = json.loads(str(inputs["bsdf"]))
    return {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "mesh": {"type": "ply", "filename": str(inputs["mesh"]), "bsdf": coat},
        "sensor": sensor,
    }


def rendering(scene: Any) -> Callable[[], Arrays]:
    """Return the action that renders a scene, with another seed in every call."""
    seeds = count()

    def action() -> Arrays:
        return {"radiance": np.asarray(mi.render(scene, seed=next(seeds)))[:, :, 0]}

    return action

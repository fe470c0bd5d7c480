"""Decoding of Gray code, and rendering by the projector of `gsoup` in Mitsuba."""

from collections.abc import Callable

import numpy as np

from benchmarks.contest.child import Arrays


def decode(inputs: Arrays) -> Callable[[], Arrays]:
    """Decode Gray code to whole projector pixels."""
    from gsoup.procam import GrayCode

    # It halves the number of frames, so that both axes need as many bits: a bit 0 before the rows'.
    images, bits = inputs["gray"], (1280 - 1).bit_length()
    white, black = images[-2:-1], images[-1:]
    codes, inverse = images[:-2:2], images[1:-2:2]
    codes = np.concatenate((codes[:bits], black, codes[bits:]))
    inverse = np.concatenate((inverse[:bits], white, inverse[bits:]))
    captures = np.concatenate((codes, inverse, white, black))[..., np.newaxis]

    def action() -> Arrays:
        decoded_px, foreground = GrayCode().decode(captures, (1280, 1280), mode="xy")
        return {"px": np.where(foreground[..., np.newaxis], decoded_px, np.nan)}

    return action


def frame(inputs: Arrays) -> Callable[[], Arrays]:
    """Render with its own emitter, which has no offset principal point in this version."""
    import mitsuba as mi
    from gsoup.procam import ProjectorScene

    from benchmarks.contest.with_mitsuba import rendering, scene_dict

    ProjectorScene()  # sets the variant and registers the emitter
    emitter = {
        "type": "projector_py",
        "to_world": mi.ScalarTransform4f(inputs["projector_to_world"]),
        "fov": float(inputs["canvas_fov_deg"]),
        "irradiance": texture(inputs["canvas"]),
        "scale": float(inputs["scale"]),
    }
    return rendering(mi.load_dict(scene_dict(inputs) | {"emitter": emitter}))


def texture(image: np.ndarray) -> dict[str, object]:
    """Return an image, (row, col), as a texture of three equal channels."""
    import mitsuba as mi

    colours = np.repeat(image[..., np.newaxis], 3, axis=2)
    return {"type": "bitmap", "bitmap": mi.Bitmap(colours), "raw": True}

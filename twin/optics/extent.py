"""How near to the projector, and how far from it, the surfaces of a scene lie."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics.connection import Rig


def axial_range_mm(scene: Any, rig: Rig) -> tuple[float, float]:
    """Return the nearest and farthest distance along the projector's axis of a scene's box.

    Parameters
    ----------
    scene : mi.Scene
    rig : Rig
        Through its layers points seem nearer than they are, but never above the highest face.

    Raises
    ------
    ValueError
        The scene reaches behind the projector.
    """
    corners = box_corners_mm(scene.bbox())
    if rig.layers is not None:
        raised = corners.copy()
        raised[:, 2] = np.maximum(raised[:, 2], max(medium.top_mm for medium in rig.layers.media))
        corners = np.concatenate([corners, raised])
    T_world_from_proj = rig.projector.T_world_from_device
    axial_mm = (corners - T_world_from_proj[:3, 3]) @ T_world_from_proj[:3, 2]
    if axial_mm.min() <= 0.0:
        raise ValueError("the scene reaches behind the projector: its blur has no bound there")
    return float(axial_mm.min()), float(axial_mm.max())


def box_corners_mm(box: Any) -> NDArray[np.float64]:
    """Corners (8, 3) of a `mi.BoundingBox3f`."""
    low, high = np.array(box.min, np.float64).ravel(), np.array(box.max, np.float64).ravel()
    return np.where(np.array(list(np.ndindex(2, 2, 2))), high, low)

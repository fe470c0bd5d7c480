"""The press by ContactMechanics: a periodic layer on a rigid base."""

from collections.abc import Callable

import numpy as np
from ContactMechanics import PeriodicFFTElasticHalfSpace
from ContactMechanics.Factory import make_system
from SurfaceTopography import Topography

from benchmarks.contest.child import Arrays


def press(inputs: Arrays) -> Callable[[], Arrays]:
    """Press a ball into a bonded layer of unit modulus, to a depth."""
    cells, side_mm, radius_mm = (float(inputs[key]) for key in ("cells", "side_mm", "radius_mm"))
    count, sizes = (int(cells),) * 2, (side_mm,) * 2
    layer = {"thickness": float(inputs["thickness_mm"]), "poisson": float(inputs["nu"])}
    substrate = PeriodicFFTElasticHalfSpace(count, 1.0, sizes, **layer)
    x_mm = (np.arange(count[0]) + 0.5) * (side_mm / cells) - side_mm / 2
    square = np.minimum(x_mm[:, None] ** 2 + x_mm**2, radius_mm**2)
    heights_mm = np.sqrt(radius_mm**2 - square) - radius_mm
    system = make_system(substrate=substrate, surface=Topography(heights_mm, sizes))
    depth_mm = float(inputs["depth_mm"])

    def action() -> Arrays:
        solution = system.minimize_proxy(offset=depth_mm)
        if not solution.success:
            raise RuntimeError(str(solution.message))
        return {"force_mm2": np.array(system.compute_normal_force())}

    return action

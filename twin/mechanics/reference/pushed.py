"""What a rigid object does to the body that it touches: forces and their derivative."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from reconstruction.arrays import FloatArray
from twin.mechanics.control import BoolArray
from twin.mechanics.reference.grid import Surface


@dataclass(frozen=True)
class Pushed:
    """The action of a contact at one state, over Young's modulus."""

    #: (displacement unknown,) force on the body
    force: FloatArray
    #: (displacement unknown, displacement unknown) its negative derivative
    stiffness: sparse.csr_array
    #: (point,) pressure and tangential stress per undeformed area
    pressure: FloatArray
    drag: FloatArray
    #: force along the press, the last axis
    along: float

    @property
    def active(self) -> BoolArray:
        """(point,) where there is contact."""
        return np.asarray(self.pressure > 0)


def push(
    surface: Surface,
    traction: FloatArray,
    stiffness: FloatArray,
    pressure: FloatArray,
    drag: FloatArray,
) -> Pushed:
    """Gather what acts at the points of a surface.

    Parameters
    ----------
    surface : Surface
        Points on the touched face.
    traction : (point, axis) float
        Per undeformed area.
    stiffness : (point, axis, axis) float
        Negative derivative of the traction by the point's position, per mm.
    pressure, drag : (point,) float
        Normal and tangential stress per undeformed area.
    """
    weight, wide = surface.weight_mm2, surface.vector_trace
    points = np.arange(weight.size + 1)
    blocks = sparse.bsr_array((stiffness * weight[:, None, None], points[:-1], points))
    return Pushed(
        force=wide.T @ (traction * weight[:, None]).ravel(),
        stiffness=sparse.csr_array(wide.T @ blocks.tocsr() @ wide),
        pressure=pressure,
        drag=drag,
        along=float(weight @ traction[:, -1]),
    )

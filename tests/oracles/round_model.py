"""Parts of the one-dimensional sheet: splines, sheet, loads. See `round_sheet`."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from reconstruction.arrays import FloatArray
from tests.oracles.sections import Section

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Line:
    """Quadratic B-splines on graded cells of 0..rim, fine near the axis and at the rim."""

    rim_mm: float
    fine_mm: float
    pitch_mm: float
    growth: float = 0.12
    coarse_mm: float = 0.25

    @cached_property
    def edges_mm(self) -> FloatArray:
        s = np.linspace(0, self.rim_mm, 20001)
        away = np.minimum(np.maximum(s - self.fine_mm, 0), self.rim_mm - s)
        density = 1 / np.minimum(self.pitch_mm + self.growth * away, self.coarse_mm)
        cells = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2))) * s[1]
        return np.interp(np.linspace(0, cells[-1], int(np.ceil(cells[-1])) + 1), cells, s)

    @cached_property
    def knots_mm(self) -> FloatArray:
        return np.concatenate(([0.0] * 2, self.edges_mm, [self.rim_mm] * 2))

    @cached_property
    def size(self) -> int:
        return self.edges_mm.size + 1

    @cached_property
    def greville_mm(self) -> FloatArray:
        return (self.knots_mm[1:-2] + self.knots_mm[2:-1]) / 2

    @cached_property
    def points_mm(self) -> FloatArray:
        """Two Gauss points per cell."""
        shares = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
        return (self.edges_mm[:-1, None] + np.diff(self.edges_mm)[:, None] * shares).ravel()

    @cached_property
    def weights_mm(self) -> FloatArray:
        return np.repeat(np.diff(self.edges_mm) / 2, 2)

    @cached_property
    def local(self) -> FloatArray:
        """(point, derivative, function): the three splines that are not 0 at each Gauss point."""
        cell = np.repeat(np.arange(self.size - 2), 2)[:, None] + np.arange(3)
        return np.stack(
            [np.take_along_axis(self.table(self.points_mm, d), cell, 1) for d in range(3)], axis=1
        )

    def table(self, at_mm: FloatArray, derivative: int) -> FloatArray:
        """Return all splines at (point,): (point, function)."""
        return BSpline(self.knots_mm, np.eye(self.size), 2)(at_mm, nu=derivative)


@dataclass(frozen=True)
class RoundSheet:
    """A sheet, its support and its specimen."""

    section: Section
    thickness_mm: float
    young_modulus_mpa: float
    rim_mm: float
    plane_strain: bool = False
    #: no slope at the rim; otherwise free to turn there
    clamped: bool = True
    stick: bool = False
    #: adhesion energy in N/mm per undeformed area and the range of its forces
    tack_n_mm: float = 0.0
    tack_range_mm: float = 0.08
    #: not a mirror at S = 0 but an end that is free along x and lifted
    lifted_end: bool = False
    pitch_mm: float = 0.05
    fine_mm: float = 5.0

    @property
    def shear_modulus_mpa(self) -> float:
        return self.young_modulus_mpa / 3

    @cached_property
    def line(self) -> Line:
        return Line(self.rim_mm, self.fine_mm, self.pitch_mm)

    @cached_property
    def weights_mm2(self) -> FloatArray:
        """(point,) undeformed area; a strip counts with both its halves."""
        line = self.line
        if self.plane_strain:
            return line.weights_mm * (1 if self.lifted_end else 2)
        return 2 * np.pi * line.points_mm * line.weights_mm

    @cached_property
    def unknowns(self) -> IntArray:
        """(2 n,) number of the free unknown behind each coefficient, -1 where it is held."""
        n = self.line.size
        free = np.ones((n, 2), dtype=bool)
        free[-1] = False
        free[-2, 1] = not self.clamped
        free[0] = (True, False) if self.lifted_end else (False, False)
        number = np.where(free, np.cumsum(free).reshape(n, 2) - 1, -1)
        if not self.lifted_end:
            number[0, 1] = number[1, 1]  # no slope on the axis
        return number.ravel()


@dataclass(frozen=True)
class Anchors:
    """Where Gauss points (point,) stick to the specimen, in its own frame."""

    held: npt.NDArray[np.bool_]
    x_mm: FloatArray
    z_mm: FloatArray
    #: unit tangent there, frozen: the anchoring is a true potential
    tangent_x: FloatArray
    tangent_z: FloatArray


@dataclass(frozen=True)
class Load:
    """The prescribed travel, pressure and lift."""

    travel_mm: float = 0.0
    #: on the upper face, along -z on the flat sheet, following the surface
    pressure_mpa: float = 0.0
    #: of the lifted end
    lift_mm: float = 0.0

    def towards(self, goal: "Load", share: float) -> "Load":
        """Return the load a share of the way to another."""
        here, there = (np.array(list(vars(load).values())) for load in (self, goal))
        return Load(*(here + share * (there - here)).tolist())

"""Irradiance that photons brought to the stage, for every frame, on a regular grid.

Each photon is shared out to the four nodes round it (bilinear weights), with the light of its
projector pixel in every frame; what camera paths find is, in the mean, interpolated between the
nodes. Both together blur by 0.06 mm standard deviation, a third of a projector pixel of the
paper's rig.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numba
import numpy as np

from reconstruction.arrays import FloatImage
from twin.optics.light import OVERSAMPLING, LightTable
from twin.optics.photons import Photons

PITCH_MM = 0.1
_PACKET = 4


@dataclass(frozen=True, eq=False)
class IrradianceMap:
    """Irradiance of the stage by photons.

    Attributes
    ----------
    irradiance : (row, col, frame) float32, mW/mm^2
        Frames in the order of the tables: those of the columns, then those of the rows; padded
        with zeros to a multiple of four.
    first_x_mm, first_y_mm : float
        World position of node (0, 0); x grows with the column, y with the row.
    pitch_mm : float
    frames : int
        How many of the last axis are not padding.
    """

    irradiance: FloatImage
    first_x_mm: float
    first_y_mm: float
    pitch_mm: float
    frames: int

    def flux_mw(self, frame: int) -> float:
        """Flux of one frame on the whole map."""
        total = self.irradiance[:, :, frame].sum(dtype=np.float64)
        return float(total) * self.pitch_mm**2


class _Places(NamedTuple):
    """Photons in units of the map's nodes and of the light tables' nodes, and their density."""

    x: FloatImage
    y: FloatImage
    column: FloatImage
    row: FloatImage
    density: FloatImage


def map_photons(
    photons: Photons, tables: dict[str, LightTable], pitch_mm: float = PITCH_MM
) -> IrradianceMap:
    """Collect photons into the irradiance of every frame."""
    columns, rows = tables["column"], tables["row"]
    frames = len(columns.frames) + len(rows.frames)
    padded = -(-frames // _PACKET) * _PACKET
    x, first_x_mm, cols = _node_coordinates(photons.x_mm, pitch_mm)
    y, first_y_mm, lines = _node_coordinates(photons.y_mm, pitch_mm)
    irradiance = np.zeros((lines, cols, padded), np.float32)
    places = _Places(
        x,
        y,
        _table_coordinates(photons.column_px, columns),
        _table_coordinates(photons.row_px, rows),
        photons.flux_mw / np.float32(pitch_mm**2),
    )
    _deposit(places, columns.profiles, rows.profiles, irradiance)
    return IrradianceMap(irradiance, first_x_mm, first_y_mm, pitch_mm, frames)


def _node_coordinates(position_mm: FloatImage, pitch_mm: float) -> tuple[FloatImage, float, int]:
    """Positions in node units, the first node and the number of nodes along one axis."""
    if position_mm.size == 0:
        return position_mm, 0.0, 2
    first = np.floor(float(position_mm.min()) / pitch_mm)
    coordinate = position_mm.astype(np.float64) / pitch_mm - first
    return coordinate.astype(np.float32), float(first * pitch_mm), int(coordinate.max()) + 2


def _table_coordinates(position_px: FloatImage, table: LightTable) -> FloatImage:
    x = (position_px - np.float32(table.first_px)) * np.float32(OVERSAMPLING)
    return np.asarray(np.clip(x, 0.0, len(table.profiles) - 1.001), np.float32)


@numba.njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")  # type: ignore[untyped-decorator]
def _deposit(
    places: _Places,
    column_profiles: FloatImage,
    row_profiles: FloatImage,
    irradiance: FloatImage,
) -> None:
    """Add every photon to four nodes of the map."""
    x, y, column, row, density = places
    on_columns, on_rows = column_profiles.shape[1] - 1, row_profiles.shape[1] - 1
    frames = on_columns + on_rows
    light = np.zeros(frames, np.float32)
    for photon in range(x.size):
        i, j = int(x[photon]), int(y[photon])
        right, up = x[photon] - np.float32(i), y[photon] - np.float32(j)
        a, b = int(column[photon]), int(row[photon])
        at_a, at_b = column[photon] - np.float32(a), row[photon] - np.float32(b)
        left_a, left_b = column_profiles[a], row_profiles[b]
        right_a, right_b = column_profiles[a + 1], row_profiles[b + 1]
        edge_a = left_a[on_columns] + at_a * (right_a[on_columns] - left_a[on_columns])
        edge_b = left_b[on_rows] + at_b * (right_b[on_rows] - left_b[on_rows])
        for k in range(on_columns):
            light[k] = edge_b * (left_a[k] + at_a * (right_a[k] - left_a[k]))
        for k in range(on_rows):
            light[on_columns + k] = edge_a * (left_b[k] + at_b * (right_b[k] - left_b[k]))
        for dj in range(2):
            along = density[photon] * (up if dj else np.float32(1.0) - up)
            for di in range(2):
                share = along * (right if di else np.float32(1.0) - right)
                node = irradiance[j + dj, i + di]
                for k in range(frames):
                    node[k] += share * light[k]


class StageLight:
    """An irradiance map on the device."""

    def __init__(self, received: IrradianceMap) -> None:
        rows, cols, padded = received.irradiance.shape
        self._values = mi.Float(received.irradiance.ravel())
        self._rows, self._cols, self._packets = rows, cols, padded // _PACKET
        self._map = received

    def values(
        self, x_mm: Any, y_mm: Any, weight: Any, active: Any, random: tuple[Any, Any]
    ) -> list[Any]:
        """Irradiance of every frame at points on the stage, times `weight`.

        Of the four nodes round a point one is drawn, with its bilinear weight as probability
        (`random`: two numbers in [0, 1)): the same mean as interpolation for a quarter of the
        memory traffic, and the paths are random anyway.
        """
        x = (x_mm - self._map.first_x_mm) / self._map.pitch_mm
        y = (y_mm - self._map.first_y_mm) / self._map.pitch_mm
        inside = active & (x >= 0.0) & (y >= 0.0) & (x < self._cols - 1) & (y < self._rows - 1)
        i, j = (
            mi.UInt32(dr.select(inside, place + shift, 0.0))
            for place, shift in zip((x, y), random, strict=True)
        )
        first = dr.fma(j, self._cols, i) * self._packets
        weight = dr.select(inside, weight, 0.0)
        values: list[Any] = []
        for packet in range(self._packets):
            found = dr.gather(mi.Vector4f, self._values, first + packet, inside)
            values += [found[k] * weight for k in range(_PACKET)]
        return values[: self._map.frames]

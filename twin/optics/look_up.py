"""Look up the light of all frames at a projector position, inside a kernel."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from twin.optics.connection import Connection
from twin.optics.light import OVERSAMPLING, LightTable

_PACKET = 4


class FrameLight:
    """The light tables of both axes on the device."""

    def __init__(self, tables: dict[str, LightTable]) -> None:
        self._columns, self._rows = _Table(tables["column"]), _Table(tables["row"])
        #: index of each value that `values` returns in the projected sequence
        self.sequence = [*tables["column"].frames, *tables["row"].frames]

    def values(self, path: Connection) -> list[Any]:
        """Radiance that one path adds to each frame, in the order of `sequence`."""
        # The last profile of each table is the image's blurred outline.
        *columns, column_outline = self._columns.look_up(path.column_px, path.lit)
        *rows, row_outline = self._rows.look_up(path.row_px, path.lit)
        on_columns, on_rows = path.weight * row_outline, path.weight * column_outline
        return [light * on_columns for light in columns] + [light * on_rows for light in rows]


class _Table:
    """A light table on the device, rows padded to whole packets of contiguous profiles."""

    def __init__(self, table: LightTable) -> None:
        nodes, profiles = table.profiles.shape
        self.packets = -(-profiles // _PACKET)
        padded = np.zeros((nodes, self.packets * _PACKET), np.float32)
        padded[:, :profiles] = table.profiles
        self.values = mi.Float(padded.ravel())
        self.first_px, self.nodes, self.profiles = table.first_px, nodes, profiles

    def look_up(self, position_px: Any, active: Any) -> list[Any]:
        """Interpolate every profile at a projector coordinate; 0 outside the table."""
        x = (position_px - self.first_px) * OVERSAMPLING
        inside = active & (x >= 0.0) & (x < self.nodes - 1.0)
        node = mi.UInt32(dr.select(inside, x, 0.0))
        upper = x - mi.Float(node)
        lower = 1.0 - upper
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(node, self.packets, packet)
            a = dr.gather(mi.Vector4f, self.values, index, inside)
            b = dr.gather(mi.Vector4f, self.values, index + self.packets, inside)
            values += [dr.fma(a[i], lower, b[i] * upper) for i in range(_PACKET)]
        return values[: self.profiles]

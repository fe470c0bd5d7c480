"""Look up the light of all frames at a projector position, inside a kernel."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from twin.optics.connection import Connection
from twin.optics.defocus import LEAST_VARIANCE_PX2, BlurLevels
from twin.optics.light import OVERSAMPLING, LightTable

_PACKET = 4


class FrameLight:
    """The light tables of both axes on the device."""

    def __init__(self, tables: dict[str, LightTable]) -> None:
        self._columns, self._rows = _on_device(tables["column"]), _on_device(tables["row"])
        #: the blur depends on the distance, so paths must carry it
        self.defocused = tables["column"].levels is not None
        #: index of each value that `values` returns in the projected sequence
        self.sequence = [*tables["column"].frames, *tables["row"].frames]

    def values(self, path: Connection) -> list[Any]:
        """Radiance that one path adds to each frame, in the order of `sequence`."""
        # The last profile of each table is the image's blurred outline.
        *columns, column_outline = self._columns.look_up(path.column_px, path.axial_mm, path.lit)
        *rows, row_outline = self._rows.look_up(path.row_px, path.axial_mm, path.lit)
        on_columns, on_rows = path.weight * row_outline, path.weight * column_outline
        return [light * on_columns for light in columns] + [light * on_rows for light in rows]


def _on_device(table: LightTable) -> "_LookUpTable":
    return _LookUpTable(table) if table.levels is None else _DefocusedTable(table, table.levels)


class _LookUpTable:
    """A light table on the device, rows padded to whole packets of contiguous profiles."""

    def __init__(self, table: LightTable) -> None:
        self.nodes, self.profiles = table.profiles.shape
        self.first_px, self.packets = table.first_px, -(-self.profiles // _PACKET)
        self.values = self._padded(table.profiles)

    def _padded(self, profiles: NDArray[np.float32]) -> Any:
        padded = np.zeros((*profiles.shape[:-1], self.packets * _PACKET), np.float32)
        padded[..., : self.profiles] = profiles
        return mi.Float(padded.ravel())

    def look_up(self, position_px: Any, _axial_mm: Any, active: Any) -> list[Any]:
        """Interpolate every profile at a projector coordinate; 0 outside the table."""
        node, upper, inside = self._between_nodes(position_px, active)
        lower = 1.0 - upper
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(node, self.packets, packet)
            a = dr.gather(mi.Vector4f, self.values, index, inside)
            b = dr.gather(mi.Vector4f, self.values, index + self.packets, inside)
            values += [dr.fma(a[i], lower, b[i] * upper) for i in range(_PACKET)]
        return values[: self.profiles]

    def _between_nodes(self, position_px: Any, active: Any) -> tuple[Any, Any, Any]:
        """Lower node, share of the upper one, and which positions are inside the table."""
        x = (position_px - self.first_px) * OVERSAMPLING
        inside = active & (x >= 0.0) & (x < self.nodes - 1.0)
        node = mi.UInt32(dr.select(inside, x, 0.0))
        return node, x - mi.Float(node), inside


class _DefocusedTable(_LookUpTable):
    """Light tables at several blurs, interpolated at the blur of each path's distance."""

    def __init__(self, table: LightTable, levels: BlurLevels) -> None:
        super().__init__(table)
        self.levels = levels
        self.values = self._padded(np.asarray(table.defocused))

    def look_up(self, position_px: Any, axial_mm: Any, active: Any) -> list[Any]:
        """Interpolate every profile at a projector coordinate and distance; 0 outside."""
        node, upper, inside = self._between_nodes(position_px, active)
        level, blurred = self._between_levels(axial_mm, inside)
        next_level = self.nodes * self.packets
        first = dr.fma(level, self.nodes, node)
        values: list[Any] = []
        for packet in range(self.packets):
            index = dr.fma(first, self.packets, packet)
            corners = (index, index + self.packets)
            a, b = (dr.gather(mi.Vector4f, self.values, at, inside) for at in corners)
            c, d = (dr.gather(mi.Vector4f, self.values, at + next_level, inside) for at in corners)
            found = dr.lerp(dr.lerp(a, b, upper), dr.lerp(c, d, upper), blurred)
            values += [found[i] for i in range(_PACKET)]
        return values[: self.profiles]

    def _between_levels(self, axial_mm: Any, active: Any) -> tuple[Any, Any]:
        """Lower blur level and share of the upper one."""
        variance_px2 = dr.select(active, self.levels.defocus.variance_px2(axial_mm), 1.0)
        variance_px2 = dr.maximum(variance_px2, LEAST_VARIANCE_PX2)
        level = (dr.log(variance_px2) - self.levels.first_log) / self.levels.step_log()
        level = dr.clip(level, 0.0, self.levels.count - 1.0)
        lower = dr.minimum(mi.UInt32(level), self.levels.count - 2)
        return lower, level - mi.Float(lower)

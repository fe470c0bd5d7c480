"""Draw the section of the live view as SVG: z (mm) over the position s (mm) along the section."""

from collections.abc import Iterator

import numpy as np
from matplotlib.ticker import MaxNLocator

from reconstruction.arrays import FloatArray
from twin.viewer.scene import SectionProfiles

_WIDTH, _HEIGHT = 310, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 36, 6, 8, 30
_MARGIN = 0.06
_LINES = (
    ("coat", "coat_mm", "#c80050", 2.0),
    ("touched face", "touched_mm", "#5a6470", 1.0),
    ("specimen", "specimen_mm", "#a08c64", 2.0),
)


def section_drawing(section: SectionProfiles) -> str:
    """Return the profiles of coat, touched face and specimen as HTML with an SVG picture.

    The heights are those of both faces; the specimen is cut off below them.
    """
    low, high = _range_mm(section)
    axes = _Axes(float(section.s_mm[0]), float(section.s_mm[-1]), low, high)
    curves = "".join(
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
        for _, name, colour, width in _LINES
        for points in axes.curves(section.s_mm, getattr(section, name))
    )
    legend = " ".join(
        f'<span style="color:{colour}">&#9644; {label}</span>' for label, _, colour, _ in _LINES
    )
    return (
        '<div style="font-size:0.8em;margin:0.4em 0.7em">section: z (mm) over s (mm), '
        f"z enlarged {axes.enlargement:.2g} times<br>{legend}"
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" font-size="10">'
        f"{axes.ticks()}{curves}</svg></div>"
    )


class _Axes:
    """Axes of the drawing: s along x, z along y, with ticks."""

    def __init__(self, left: float, right: float, low: float, high: float) -> None:
        self._s, self._z = (left, right), (low, high)
        self._per_s = (_WIDTH - _LEFT - _RIGHT) / (right - left)
        self._per_z = (_HEIGHT - _TOP - _BOTTOM) / (high - low)

    @property
    def enlargement(self) -> float:
        """Scale of z over that of s."""
        return self._per_z / self._per_s

    def curves(self, s_mm: FloatArray, z_mm: FloatArray) -> Iterator[str]:
        """Yield the points, for SVG, of each part of a curve that is within the axes."""
        inside = np.isfinite(z_mm) & (z_mm >= self._z[0]) & (z_mm <= self._z[1])
        ends = np.flatnonzero(np.diff(inside, prepend=False, append=False))
        for start, stop in ends.reshape(-1, 2):
            yield " ".join(
                f"{self._x(s):.1f},{self._y(z):.1f}"
                for s, z in zip(s_mm[start:stop], z_mm[start:stop], strict=True)
            )

    def ticks(self) -> str:
        """Return the ticks of both axes with their numbers, as SVG."""
        bottom = _HEIGHT - _BOTTOM
        along = "".join(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{bottom}" stroke="#ddd"/>'
            f'<text x="{x:.1f}" y="{bottom + 14}" text-anchor="middle">{s:g}</text>'
            for s, x in ((s, self._x(s)) for s in _tick_values(*self._s))
        )
        up = "".join(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 4}" y="{y + 3:.1f}" text-anchor="end">{z:g}</text>'
            for z, y in ((z, self._y(z)) for z in _tick_values(*self._z))
        )
        return along + up

    def _x(self, s: float) -> float:
        return _LEFT + (s - self._s[0]) * self._per_s

    def _y(self, z: float) -> float:
        return _TOP + (self._z[1] - z) * self._per_z


def _range_mm(section: SectionProfiles) -> tuple[float, float]:
    faces = np.concatenate((section.coat_mm, section.touched_mm))
    low, high = float(faces.min()), float(faces.max())
    margin = _MARGIN * max(high - low, 1e-3)
    return low - margin, high + margin


def _tick_values(low: float, high: float) -> list[float]:
    ticks = MaxNLocator(5).tick_values(low, high)
    return [float(tick) for tick in ticks if low <= tick <= high]

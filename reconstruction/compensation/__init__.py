"""From the relief of the coat to the rigid object that made it, with no truth at hand."""

from reconstruction.compensation.parts import Part, parts_of
from reconstruction.compensation.relief import Frame, Relief
from reconstruction.compensation.sheet import CompensatedSheet, SheetLayer, compensate_sheet

__all__ = [
    "CompensatedSheet",
    "Frame",
    "Part",
    "Relief",
    "SheetLayer",
    "compensate_sheet",
    "parts_of",
]

"""Positions of a stage that moves the specimen during a capture: table [stage] of capture.toml."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_number
from reconstruction.patterns import PatternSet


@dataclass(frozen=True)
class StageMotion:
    """Positions of a stage that moves the specimen during a capture.

    Parameters
    ----------
    positions_mm : x, y, z of the stage in the world frame for each frame of the sequence, mm; any
        origin
    velocity_mm_per_frame : in place of `positions_mm`, the same x, y, z from frame to frame
    surface_z_mm : world z of the nominal surface at the reference position
    reference_frame : frame at whose position the surface is reconstructed; None: the mean position
        during the phase frames
    reference_mm : x, y, z of the stage at which the surface is reconstructed, in place of
        `reference_frame`, in the frame of `positions_mm`

    Raises
    ------
    InputError : neither or both of positions and velocity are given, `reference_mm` is given with
        one of the others or without positions, or a value is out of range
    """

    positions_mm: tuple[tuple[float, ...], ...] = ()
    velocity_mm_per_frame: tuple[float, ...] = ()
    surface_z_mm: float = 0.0
    reference_frame: int | None = None
    reference_mm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.positions_mm) == bool(self.velocity_mm_per_frame):
            raise InputError("stage: give either positions_mm or velocity_mm_per_frame")
        rows = tuple(self.positions_mm) or (self.velocity_mm_per_frame,)
        name = "stage positions_mm" if self.positions_mm else "stage velocity_mm_per_frame"
        for row in rows:
            _check_place(name, row)
        object.__setattr__(self, "positions_mm", tuple(map(tuple, self.positions_mm)))
        object.__setattr__(self, "velocity_mm_per_frame", tuple(self.velocity_mm_per_frame))
        require_number("stage surface_z_mm", self.surface_z_mm, -1e4, 1e4)
        if not self.reference_mm:
            return
        _check_place("stage reference_mm", self.reference_mm)
        object.__setattr__(self, "reference_mm", tuple(self.reference_mm))
        if self.reference_frame is not None or not self.positions_mm:
            raise InputError(
                "stage reference_mm: allowed with positions_mm and without reference_frame; leave"
                " one of them out"
            )

    def displacements_mm(self, patterns: PatternSet) -> FloatArray:
        """Return the position of each frame minus the reference position, (frame, xyz) mm.

        Raises
        ------
        InputError : another number of positions than of frames, or no such reference frame
        """
        count = len(patterns.frames)
        if self.positions_mm:
            positions = np.array(self.positions_mm, np.float64)
        else:
            positions = np.arange(count)[:, np.newaxis] * np.array(self.velocity_mm_per_frame)
        if len(positions) != count:
            raise InputError(
                f"stage positions_mm has {len(positions)} positions; the sequence has {count}"
                " frames, give one position for each"
            )
        if self.reference_mm:
            return np.asarray(positions - np.array(self.reference_mm))
        if self.reference_frame is None:
            shown = [n for n, frame in enumerate(patterns.frames) if frame.kind == "phase"]
            return np.asarray(positions - positions[shown or slice(None)].mean(axis=0))
        if not 0 <= self.reference_frame < count:
            raise InputError(
                f"stage reference_frame is {self.reference_frame}; allowed are 0 to {count - 1}"
            )
        return np.asarray(positions - positions[self.reference_frame])


def _check_place(name: str, place: object) -> None:
    if not isinstance(place, (tuple, list)) or len(place) != 3:
        raise InputError(f"{name} has the entry {place!r}; give x, y and z in mm")
    for value in place:
        require_number(name, value, -1e4, 1e4)

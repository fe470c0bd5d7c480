"""Limits of the numbers of cells and nodes of a press, checked before it is solved.

Memory per node of the coated face, with its mesh: 150 bytes for a slab and 240 for a sheet. Memory
per cell of the slab's grid: 120 bytes. All were measured on 2 to 5 million nodes or cells.
"""

import math

from twin.config.models import Elastomer, Press
from twin.mechanics.errors import PressError

MOST_FACE_NODES = 20_000_000
MOST_SLAB_CELLS = 20_000_000


def check_face_nodes(elastomer: Elastomer, load: Press) -> None:
    """Raise an error if the mesh of the coated face would take more than some 5 GB of memory.

    Raises
    ------
    PressError : the message states lengths, pitch and the finest allowed pitch
    """
    _check(
        "press.relief_pitch_mm",
        load.relief_pitch_mm,
        (elastomer.length_x_mm, elastomer.length_y_mm),
        (MOST_FACE_NODES, "nodes of the coated face", "some 5 GB"),
    )


def check_slab_cells(window_mm: tuple[float, float], load: Press) -> None:
    """Raise an error if the grid of a slab would take more than some 3 GB of memory.

    Parameters
    ----------
    window_mm : lengths of the grid along x and y

    Raises
    ------
    PressError : the message states lengths, pitch and the finest allowed pitch
    """
    _check(
        "press.solver_pitch_mm",
        load.solver_pitch_mm,
        window_mm,
        (MOST_SLAB_CELLS, "cells of the solver's grid", "some 3 GB"),
    )


def _check(
    key: str, pitch_mm: float, lengths_mm: tuple[float, float], most: tuple[int, str, str]
) -> None:
    (x_mm, y_mm), (count, of, memory) = lengths_mm, most
    requested = (x_mm / pitch_mm) * (y_mm / pitch_mm)
    if requested > count:
        least_mm = math.sqrt(x_mm * y_mm / count)
        raise PressError(
            f"{key}: found {pitch_mm:g} on {x_mm:.4g} x {y_mm:.4g} mm, which takes {requested:.2g} "
            f"{of}, allowed up to {count:.2g} ({memory}), a pitch of {least_mm:.2g} or more; use a "
            "coarser one, or shorten elastomer.length_x_mm and length_y_mm"
        )

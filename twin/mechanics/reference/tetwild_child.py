"""Program that runs pytetwild for `tetrahedra` in its own process, which pytetwild may crash.

Its arguments are an input and an output path (npz). It imports no module of the twin, so that it
starts fast. It ends with its parent: a mesh may take minutes, in which no Python code runs.
"""

import ctypes
import importlib.util
import signal
import sys
import types

import numpy as np

_PR_SET_PDEATHSIG = 1  # of Linux, see prctl(2)


def end_with_parent() -> None:
    """End this process when its parent ends (Linux) or when Ctrl-C is pressed, also in a mesher."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def main(source: str, target: str) -> None:
    """Mesh the surface in the file `source`, and write points and tetrahedra to `target`."""
    if importlib.util.find_spec("pyvista") is None:
        # pytetwild registers an accessor with PyVista on import, which is not needed here.
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    import pytetwild

    with np.load(source) as data:
        points, cells = pytetwild.tetrahedralize(
            data["points"],
            data["facets"].astype(np.int32),
            edge_length_abs=float(data["size"].max()),
            epsilon=float(data["epsilon"]),
            bg_vertices=data["background_points"],
            bg_tets=data["background_cells"].astype(np.int32),
            bg_values=data["size"],
            vtk_ordering=True,
            quiet=True,
        )
    np.savez(target, points=points, cells=cells)


if __name__ == "__main__":
    end_with_parent()
    main(sys.argv[1], sys.argv[2])

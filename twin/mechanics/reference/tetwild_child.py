"""Program that runs pytetwild for `tetrahedra` in its own process, which pytetwild may crash.

Its arguments are an input and an output path (npz), and the limit of its processor time in seconds,
at which SIGXCPU ends it. It imports no module of the twin, so that it
starts fast. It ends with its parent: a mesh may take minutes, in which no Python code runs.
"""

import ctypes
import importlib.util
import math
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


def limit_processor_time(limit_s: float) -> None:
    """End this process when all its threads together have used `limit_s` (not on Windows)."""
    if sys.platform != "win32":
        import resource

        most = resource.getrlimit(resource.RLIMIT_CPU)[1]
        allowed = math.ceil(limit_s)
        if most == resource.RLIM_INFINITY or allowed < most:
            resource.setrlimit(resource.RLIMIT_CPU, (allowed, most))


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
    limit_processor_time(float(sys.argv[3]))
    main(sys.argv[1], sys.argv[2])

"""Mesh files of other programs: read as the right solid, or rejected.

    ./run bench reality_meshes [--quick]

300 files (--quick: 60) of `tests/corpus/meshes.py`, and the public files of ../shared/cases if
present. A file is right if volume and bounds of the closed surface agree with the true solid within
1e-6 of its size; a file that describes no closed surface, if it is rejected with one line.

Last line: {"meshes_read", "meshes"}: share of the files, number of files.
"""

import tempfile
from pathlib import Path

import numpy as np
import trimesh

from benchmarks._harness import print_figures, quick_parser
from reconstruction.errors import InputError
from tests.corpus.meshes import write_mesh
from twin.specimens.mesh_files import read_closed_mesh

FILES, QUICK_FILES = 300, 60
CLOSE = 1e-6
CASES = Path(__file__).parents[2] / "shared" / "cases" / "08_meshes"
# Volume, cubic units of the file, and its relative tolerance: two boxes by the corners in their
# files, and a ball of 6 mm in metres; its 5120 triangles enclose 0.2 % less than the ball.
PUBLIC = {
    "blendercube.obj": (64.0, 1e-6),
    "charuco_board.obj": (7.2e-4, 1e-6),
    "metres_ball.stl": (np.pi / 6 * 0.006**3, 3e-3),
}


def main() -> None:
    parser = quick_parser(__doc__ or "", "60 generated files")
    print_figures(reality_meshes(parser.parse_args().quick))


def reality_meshes(quick: bool) -> dict[str, float]:
    """Read generated and public files."""
    verdicts = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(QUICK_FILES if quick else FILES):
            written = write_mesh(Path(folder), seed)
            verdicts.append(is_read_rightly(written.file, written.solid))
            if not verdicts[-1]:
                print(f"{written.layout} (seed {seed}): wrong", flush=True)
    for name, (volume, tolerance) in PUBLIC.items():
        if (CASES / name).exists():
            read = read_closed_mesh("file", str(CASES / name))
            verdicts.append(abs(read.volume - volume) < tolerance * volume)
    return {"meshes_read": sum(verdicts) / len(verdicts), "meshes": len(verdicts)}


def is_read_rightly(file: Path, solid: trimesh.Trimesh | None) -> bool:
    """Return True if a file gives the solid, or, if `solid` is None, one line of an InputError."""
    try:
        read = read_closed_mesh("file", str(file))
    except InputError as error:
        return solid is None and "\n" not in str(error)
    if solid is None:
        return False
    size = float(np.max(solid.extents))
    moved = float(np.max(np.abs(read.bounds - solid.bounds)))
    return moved < CLOSE * size and abs(read.volume - solid.volume) < CLOSE * size * solid.area


if __name__ == "__main__":
    main()

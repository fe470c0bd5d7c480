"""Make the example pad scenes/examples/dome.stl: a cap 4 mm high, cut from a ball of 16 mm.

.venv/bin/python docs/draw_dome.py
"""

import sys
from pathlib import Path

import trimesh

STL = Path(__file__).parents[1] / "scenes" / "examples" / "dome.stl"


def main() -> None:
    """Cut the cap with a mesh boolean and write it; the dome faces down, its window is on top."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=16.0)
    ball.apply_translation((0.0, 0.0, 16.0))
    below = trimesh.creation.box((40.0, 40.0, 4.0))
    below.apply_translation((0.0, 0.0, 2.0))
    trimesh.boolean.intersection([ball, below], engine="manifold").export(STL)
    sys.stdout.write(f"wrote {STL}\n")


if __name__ == "__main__":
    main()

"""Make the example pads scenes/examples/dome.stl and domed_block.stl.

dome.stl is a cap 4 mm high, cut from a ball of 16 mm. domed_block.stl is a block of
25.25 x 20.75 x 4.25 mm with the face of a ball of 50 mm.

.venv/bin/python docs/draw_dome.py
"""

import sys
from pathlib import Path

import trimesh

EXAMPLES = Path(__file__).parents[1] / "scenes" / "examples"


def main() -> None:
    """Cut both pads with mesh booleans and write them; a dome faces down, its window is on top."""
    pads = {
        "dome.stl": _cut(16.0, 4, (40.0, 40.0, 4.0)),
        "domed_block.stl": _cut(50.0, 5, (25.25, 20.75, 4.25)),
    }
    for name, pad in pads.items():
        pad.export(EXAMPLES / name)
        sys.stdout.write(f"wrote {EXAMPLES / name}\n")


def _cut(
    radius_mm: float, subdivisions: int, block_mm: tuple[float, float, float]
) -> trimesh.Trimesh:
    """Return the part of a block above z = 0 that is inside a ball, which touches z = 0."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    ball.apply_translation((0.0, 0.0, radius_mm))
    block = trimesh.creation.box(block_mm)
    block.apply_translation((0.0, 0.0, block_mm[2] / 2))
    return trimesh.boolean.intersection([ball, block], engine="manifold")


if __name__ == "__main__":
    main()

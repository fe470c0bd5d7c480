"""Raised text as a designer's STL has it: letters of straight strokes on a plate."""

import trimesh

# Strokes of 5 x 7 letters on a grid of stroke widths: x, y, width, height.
_STROKES = {
    "T": ((0, 6, 5, 1), (2, 0, 1, 6)),
    "L": ((0, 0, 1, 7), (1, 0, 4, 1)),
    "H": ((0, 0, 1, 7), (4, 0, 1, 7), (1, 3, 3, 1)),
    "E": ((0, 0, 1, 7), (1, 0, 4, 1), (1, 3, 3, 1), (1, 6, 4, 1)),
}


def raised_text(text, height_mm, stroke_mm):
    """Return a plate with letters, centred; its top is the letters' upper face."""
    parts, wide = [], (6 * len(text) - 1) * stroke_mm
    for place, letter in enumerate(text):
        for x, y, across, up in _STROKES[letter]:
            low = ((x + 6 * place) * stroke_mm - wide / 2, (y - 3.5) * stroke_mm, -0.5)
            high = (low[0] + across * stroke_mm, low[1] + up * stroke_mm, height_mm)
            # Strokes overlap a little: faces that only touch leave slits behind.
            parts.append(
                trimesh.creation.box(
                    bounds=[
                        [a - 1e-3 for a in low[:2]] + [low[2]],
                        [b + 1e-3 for b in high[:2]] + [high[2]],
                    ]
                )
            )
    plate = [[-wide / 2 - 2, -6 * stroke_mm, -2], [wide / 2 + 2, 6 * stroke_mm, 0]]
    return trimesh.boolean.union([trimesh.creation.box(bounds=plate), *parts], engine="manifold")

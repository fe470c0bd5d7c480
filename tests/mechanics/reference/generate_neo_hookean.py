"""Compute the stored large-strain references: `python generate_neo_hookean.py`.

Each case is the full-size axisymmetric neo-Hookean press (44 x 12 elements, frictionless);
about half a minute per case. Faces are at deformed radii, at unit Young's modulus.
"""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.oracles.axisymmetric import Resolution, RoundSlab, press_axisymmetric

STORED = Path(__file__).with_name("neo_hookean.json")
CASES = {
    "bonded_r4_h4_d1": (RoundSlab(4.0, 28.0, 0.49, "bonded"), 4.0, 1.0, Resolution()),
    "free_r4_h4_d1": (RoundSlab(4.0, 10.0, 0.49, "simple"), 4.0, 1.0, Resolution(36, 12)),
    "sheet_r4_h1_d1": (RoundSlab(1.0, 10.0, 0.49, "simple"), 4.0, 1.0, Resolution(40, 8)),
}


def main() -> None:
    r_mm = np.round(np.arange(0, 10.01, 0.05), 6)
    stored = {}
    for name, (slab, radius_mm, depth_mm, resolution) in CASES.items():
        pressed = press_axisymmetric(slab, radius_mm, depth_mm, resolution=resolution)
        stored[name] = {
            "slab": asdict(slab),
            "radius_mm": radius_mm,
            "depth_mm": depth_mm,
            "resolution": asdict(resolution),
            "force_over_modulus_mm2": round(pressed.force_over_modulus_mm2, 6),
            "r_mm": r_mm.tolist(),
            "touched_face_mm": pressed.touched_face_mm(r_mm).round(5).tolist(),
            "far_face_mm": pressed.far_face_mm(r_mm).round(5).tolist(),
        }
        print(name, stored[name]["force_over_modulus_mm2"])
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(case)}" for name, case in stored.items())
    STORED.write_text(f"{{\n{lines}\n}}\n")


if __name__ == "__main__":
    main()

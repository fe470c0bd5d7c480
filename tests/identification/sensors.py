"""A sensor with two hidden values and figures by formulas, importable by worker processes."""

import numpy as np

from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult

NOISE_MM = 0.004
REACHES = {"1": 1.0, "1p5": 1.5, "2p5": 2.5, "4": 4.0}


class Formula:
    """Return radius and height by formulas of the sheet's thickness and the press's travel."""

    def __init__(self, keep=()):
        self.keep = keep

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        thickness, depth = experiment.elastomer.thickness_mm, experiment.press.depth_mm
        noise = NOISE_MM * np.random.default_rng(int(1e9 * (thickness + depth)) % 2**32).normal()
        far = 2.0 if experiment.elastomer.layout == "contact_face" else 1.0
        figures = {
            "radius_mm": 4.0 + thickness + noise,
            "radius_far_mm": 4.0 + 2.0 * thickness + noise,
            "product_mm2": far * thickness * depth,
            "height_mm": depth * np.exp(-thickness) + noise,
            "wave_mm": 0.4 + 0.1 * np.sin(2 * np.pi * depth / 0.25) + noise,
            "warnings": [],
        }
        figures |= {f"reach_{label}_mm": thickness * r for label, r in REACHES.items()}
        return CaseResult(figures)

    def reads(self):
        return ()

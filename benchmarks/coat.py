"""Coats: flakes that glint, weights of the decoder, light that changes, points of the object.

    ./run bench coat [--quick]

- `energy_rel`: mean radiance of white on glinting coats over that on the smooth coat, less 1.
  Target: at most 0.005.
- `glint_contrast_rel`: standard deviation of the glints of one pixel over that of a compound
  Poisson process, less 1; the largest deviation of three footprints and three apertures. Target: at
  most 0.05.
- `brute_force_rms`: RMS deviation from every flake of 20 x 20 mm as explicit geometry, over the
  random error of that geometry; the largest of three apertures. Target: at most 1.1.

The figures of `coat_decoder`, `coat_light` and `coat_compensation` follow; their docstrings define
them. Each can also be run alone, for example `./run bench coat_light`.

Last line: {"energy_rel", "glint_contrast_rel", "brute_force_rms", "glint_error_um_weighted",
"glint_error_um_robust", "mae_over_rmse", "drift_left_um", "compensated_normalised",
"span_share_wrong", "pressure_over_force", ...}.
"""

from collections.abc import Callable

import numpy as np

from benchmarks._glints import BruteForce, FlatCoat, glint_facets, glinting, mean_over_smooth
from benchmarks._harness import print_figures, quick_parser
from benchmarks.coat_compensation import coat_compensation
from benchmarks.coat_decoder import coat_decoder
from benchmarks.coat_light import coat_light
from twin.optics.session import activate

FOOTPRINTS_MM = {0.01: 1200, 0.03: 800, 0.09: 400}
"""Width of a pixel on the coat, mm: number of pixels along each axis."""
PUPILS = (0.003, 0.0), (0.03, 0.02), (0.1, 0.06)
"""Radii of the pupils of camera and projector over their distance from the coat."""
APERTURES = (16.0, 0.0), (8.0, 4.0), (2.8, 10.0)
"""f-number of the camera, and diameter of the projector's pupil, mm."""


def energy(quick: bool) -> dict[str, float]:
    """Compare the mean radiance of glinting coats with that of the smooth coat."""
    return {"energy_rel": mean_over_smooth(range(2 if quick else 8)) - 1.0}


def contrast(quick: bool) -> dict[str, float]:
    """Compare the contrast of a white frame with Campbell's theorem."""
    facets, largest = glint_facets(diameter_um=10.0, facet_roughness=0.03), 0.0
    for pupils in PUPILS:
        coat = FlatCoat(facets, *pupils)
        for pitch_mm, pixels in FOOTPRINTS_MM.items():
            seeds = range(1 if quick else 4)
            images = [coat.ratio(seed, pitch_mm, pixels) for seed in seeds]
            measured, theory = float(np.std(images)), coat.contrast(pitch_mm)
            print(f"pupils {pupils}, pixel {pitch_mm} mm: {measured:.4g}, theory {theory:.4g}")
            largest = max(largest, abs(measured / theory - 1.0))
    return {"glint_contrast_rel": largest}


def brute_force(quick: bool) -> dict[str, float]:
    """Compare every pixel with the flakes as explicit geometry."""
    largest = 0.0
    for aperture in APERTURES:
        ratio = BruteForce(glinting(*aperture), samples=4 if quick else 16).rms_over_noise()
        print(f"f-number and projector pupil {aperture}: RMS over its random error {ratio:.3f}")
        largest = max(largest, ratio)
    return {"brute_force_rms": largest}


PARTS: tuple[Callable[[bool], dict[str, float]], ...] = (
    energy,
    contrast,
    brute_force,
    coat_decoder,
    coat_light,
    coat_compensation,
)


def main() -> None:
    """Run every part and print one JSON line."""
    quick = quick_parser(__doc__, "fewer coats and random points").parse_args().quick
    activate()
    figures: dict[str, float] = {}
    for part in PARTS:
        figures |= part(quick)
    print_figures(figures)


if __name__ == "__main__":
    main()

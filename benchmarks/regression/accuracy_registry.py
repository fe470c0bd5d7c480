"""Every guarded accuracy figure: what it is, what the project promises, what its floor is."""

from functools import partial

from benchmarks.regression import fringe_cases as fringe
from benchmarks.regression import other_cases as other
from benchmarks.regression.cases import Case
from benchmarks.regression.figures import Figure, Target

# Code for another processor rounds otherwise. With noise that acts like another seed (the draws of
# the camera's noise part ways), which the seeds cover; what is left is below this share.
rendered = partial(Figure, floor_rel=1e-5)

FRINGES = (
    Case(
        "two_balls",
        "968 x 732, 5 seeds",
        (
            rendered("two_balls_z_rmse_um", "two balls, default camera and filter: z RMSE, um"),
            # Sigma is kept in steps of 6e-4 of it: the median may be the next one.
            Figure("two_balls_sigma_z_um", "predicted sigma of z, median, um", floor=2.4e-4),
            rendered("two_balls_radius_mm", "apparent radius of the 8 mm balls, mm"),
            rendered("two_balls_sphere_rmse_um", "residual of the sphere fits, um RMS"),
            # The contact solver stops when the force changes by less than 1e-5.
            Figure("two_balls_force_n", "force of the press, N", floor_rel=2e-5),
            rendered("two_balls_completeness", "lit pixels with a point"),
            Figure(
                "two_balls_wrong_orders_px",
                "wrong fringe orders on lit pixels",
                target=Target(0, 0),
                floor=0.1,
            ),
            rendered(
                "two_balls_spread_over_sigma",
                "error / predicted sigma of z, default filter",
            ),
            rendered(
                "two_balls_unfiltered_spread_over_sigma",
                "the same unfiltered",
                target=Target.about(1, 0.15),
            ),
        ),
        fringe.two_balls,
    ),
    Case(
        "ideal",
        "484 x 366",
        (
            Figure(
                # Seen between code for vectors of 4 and of 8 (AVX2), as for sampling_error_px.
                "ideal_z_rmse_um",
                "z RMSE without noise and filter, um",
                target=Target(high=2),
                floor=6e-3,
            ),
        ),
        fringe.ideal,
    ),
    Case(
        "sampling",
        "320 x 240 of 968 x 732",
        (
            Figure(
                "sampling_error_px",
                "2 x 2 rays per pixel against 16 x 16, px; a third of the noise is 1.7e-3",
                target=Target(high=1.7e-3),
                floor=1e-6,
            ),
        ),
        fringe.sampling,
    ),
    Case(
        "albedo",
        "484 x 366, 5 seeds",
        (rendered("albedo_z_rmse_ratio", "unfiltered z RMSE at albedo 0.1 over that at 0.4"),),
        fringe.albedo,
    ),
    Case(
        "rod",
        "484 x 366, 5 seeds",
        (
            rendered("rod_width_mm", "rod of 7.23 mm through the sheet: width, mm"),
            rendered("rod_height_mm", "the same: height, mm"),
        ),
        fringe.rod,
    ),
    Case(
        "window",
        "484 x 366, 5 seeds",
        (
            rendered("window_radius_mm", "4 mm ball through gel and window, decoded as in air: mm"),
            rendered("window_z_bias_um", "the same: offset of z, um"),
        ),
        fringe.window,
    ),
    Case(
        "direct_nut",
        "484 x 366, 4 seeds",
        (rendered("direct_nut_completeness", "bare steel nut: pixels with a point"),),
        partial(fringe.direct, "nut", 4),
        quick=False,
    ),
    Case(
        "direct_brick",
        "484 x 366, 3 seeds",
        (rendered("direct_brick_completeness", "bare clear brick: pixels with a point"),),
        partial(fringe.direct, "brick", 3),
        quick=False,
    ),
    Case(
        "calibration",
        "12 poses of 484 x 366, 3 seeds",
        (
            Figure(
                "calibration_focal_rel",
                "calibration: focal lengths, relative",
                target=Target(high=5e-3),
            ),
            Figure(
                "calibration_plane_pv_um", "a plane measured with it, um", target=Target(high=5)
            ),
            Figure(
                "calibration_length_rms_um",
                "10 mm lengths measured with it, um",
                target=Target(high=5),
            ),
        ),
        fringe.calibration,
        quick=False,
    ),
)

OTHERS = (
    Case(
        "decode",
        "5 seeds",
        (
            Figure(
                "decode_float_rms_px", "decoded column and row, exact frames, px", floor_rel=0.01
            ),
            Figure("decode_eight_bit_rms_px", "the same, 8-bit frames, px", floor_rel=1e-3),
        ),
        other.decode,
    ),
    Case(
        "press",
        "closed forms",
        (
            Figure(
                "press_hertz_force_rel",
                "Hertz force, relative",
                target=Target(high=1e-3),
                floor=1e-6,
            ),
            Figure(
                "press_fredholm_force_rel",
                "ball on a bonded layer against Fredholm, relative",
                target=Target(high=3e-3),
                floor=2e-5,
            ),
            Figure(
                "press_large_strain_face_um",
                "face of a bonded pad against neo-Hookean, um RMS",
                target=Target(high=5),
                floor=1e-2,
            ),
        ),
        other.press,
    ),
    Case(
        "fem",
        "other mesh in every run",
        (
            Figure(
                "fem_face_um",
                "coated face against 3-D finite elements, um at most",
                target=Target(high=3),
                floor=0.25,
            ),
        ),
        other.fem,
        quick=False,
    ),
    Case(
        "photons",
        "3 seeds",
        (
            Figure(
                "photons_energy_gap_rel",
                "light sent into the clear brick and not accounted for",
                target=Target(high=0.01),
                floor=1e-5,
            ),
        ),
        other.photons,
        quick=False,
    ),
    Case(
        "gelsight",
        "4 seeds, 5 places each",
        (
            # Real presses of the same sensor, n = 29, and their spread: docs/photometric.md.
            rendered(
                "gelsight_cap_corrected",
                "GelSight-like: cap of a ball over true",
                target=Target.about(1.007, 0.05),
            ),
            rendered(
                "gelsight_cap_faithful_2025",
                "the same as the vendor integrates",
                target=Target.about(0.66, 0.035),
            ),
            rendered(
                "gelsight_cap_faithful_2024",
                "the same in the older form",
                target=Target.about(1.32, 0.07),
            ),
        ),
        other.gelsight,
        quick=False,
    ),
)

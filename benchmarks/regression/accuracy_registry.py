"""Every guarded accuracy figure: what it is, what the project promises, what its floor is."""

from functools import partial

from benchmarks.regression import fringe_cases as fringe
from benchmarks.regression import other_cases as other
from benchmarks.regression.cases import BenchmarkCase
from benchmarks.regression.figures import GuardedFigure, Target

# Code for another processor rounds otherwise. With noise that acts like another seed (the draws of
# the camera's noise part ways), which the seeds cover; what is left is below this share.
rendered = partial(GuardedFigure, floor_rel=1e-5)

FRINGES = (
    BenchmarkCase(
        "two_balls",
        "968 x 732, 5 seeds",
        (
            rendered(
                "two_balls_z_rmse_um",
                "error of z on the coat, default camera and filter: RMS over the lit pixels, um",
                headline=True,
            ),
            # Sigma is kept in steps of 6e-4 of it: the median may be the next one.
            GuardedFigure(
                "two_balls_sigma_z_um",
                "standard deviation of z predicted per pixel: median, um",
                headline=True,
                floor=2.4e-4,
            ),
            rendered(
                "two_balls_radius_mm", "fitted radius of the coat over the 8 mm balls: mean, mm"
            ),
            rendered("two_balls_sphere_rmse_um", "radial residual of the sphere fits: RMS, um"),
            # The contact solver stops when the force changes by less than 1e-5.
            GuardedFigure("two_balls_force_n", "force of the press, N", floor_rel=2e-5),
            rendered(
                "two_balls_completeness", "share of the lit pixels with a point", headline=True
            ),
            GuardedFigure(
                "two_balls_wrong_orders_px",
                "lit pixels with a wrong fringe order",
                headline=True,
                target=Target(0, 0),
                floor=0.1,
            ),
            rendered(
                "two_balls_spread_over_sigma",
                "normalised error (robust spread of error / predicted sigma) of z, default filter",
            ),
            rendered(
                "two_balls_unfiltered_spread_over_sigma",
                "normalised error (robust spread of error / predicted sigma) of z, no filter",
                headline=True,
                target=Target.about(1, 0.15),
            ),
        ),
        fringe.two_balls,
    ),
    BenchmarkCase(
        "ideal",
        "484 x 366",
        (
            GuardedFigure(
                # Seen between code for vectors of 4 and of 8 (AVX2), as for sampling_error_px.
                "ideal_z_rmse_um",
                "error of z without noise and filter: RMS, um",
                headline=True,
                target=Target(high=2),
                floor=6e-3,
            ),
        ),
        fringe.ideal,
    ),
    BenchmarkCase(
        "sampling",
        "320 x 240 of 968 x 732",
        (
            GuardedFigure(
                "sampling_error_px",
                "projector coordinate with 2 x 2 rays per pixel against 16 x 16: RMS, px (a "
                "third of the noise is 1.7e-3)",
                target=Target(high=1.7e-3),
                floor=1e-6,
            ),
        ),
        fringe.sampling,
    ),
    BenchmarkCase(
        "albedo",
        "484 x 366, 5 seeds",
        (
            rendered(
                "albedo_z_rmse_ratio",
                "error of z without filter, albedo 0.1 over albedo 0.4: ratio of RMS",
            ),
        ),
        fringe.albedo,
    ),
    BenchmarkCase(
        "rod",
        "484 x 366, 5 seeds",
        (
            rendered("rod_width_mm", "rod of 7.23 mm through the sheet: width at half height, mm"),
            rendered("rod_height_mm", "rod of 7.23 mm through the sheet: height, mm"),
        ),
        fringe.rod,
    ),
    BenchmarkCase(
        "window",
        "484 x 366, 5 seeds",
        (
            rendered("window_radius_mm", "4 mm ball through gel and window: fitted radius, mm"),
            rendered("window_z_rmse_um", "4 mm ball through gel and window: RMS error of z, um"),
            rendered(
                "window_in_air_radius_mm",
                "4 mm ball through gel and window, decoded as in air: fitted radius, mm",
            ),
            rendered(
                "window_in_air_z_bias_um",
                "4 mm ball through gel and window, decoded as in air: mean error of z, um",
            ),
        ),
        fringe.window,
    ),
    BenchmarkCase(
        "direct_nut",
        "484 x 366, 4 seeds",
        (
            rendered(
                "direct_nut_completeness",
                "bare steel nut, direct FPP: share of its pixels with a point",
            ),
        ),
        partial(fringe.direct, "nut", 4),
        quick=False,
    ),
    BenchmarkCase(
        "direct_brick",
        "484 x 366, 3 seeds",
        (
            rendered(
                "direct_brick_completeness",
                "bare clear brick, direct FPP: share of its pixels with a point",
            ),
        ),
        partial(fringe.direct, "brick", 3),
        quick=False,
    ),
    BenchmarkCase(
        "calibration",
        "12 poses of 484 x 366, 8 seeds",
        (
            # Errors of single parameters scatter by more than their mean from seed to seed; what
            # they do to lengths and planes is guarded instead.
            GuardedFigure(
                "calibration_plane_pv_um",
                "plane measured with a calibration on a dot board: peak to valley, um",
                headline=True,
                target=Target(high=5),
            ),
            GuardedFigure(
                "calibration_length_rms_um",
                "10 mm lengths measured with a calibration on a dot board: RMS error, um",
                headline=True,
                target=Target(high=5),
            ),
        ),
        fringe.calibration,
        quick=False,
    ),
)

OTHERS = (
    BenchmarkCase(
        "decode",
        "5 seeds",
        (
            GuardedFigure(
                "decode_float_rms_px",
                "decoded column and row, exact frames: RMS error, px",
                floor_rel=0.01,
            ),
            GuardedFigure(
                "decode_eight_bit_rms_px",
                "decoded column and row, 8-bit frames: RMS error, px",
                floor_rel=1e-3,
            ),
        ),
        other.decode,
    ),
    BenchmarkCase(
        "press",
        "closed forms",
        (
            GuardedFigure(
                "press_hertz_force_rel",
                "contact force of a ball against Hertz: relative error",
                headline=True,
                target=Target(high=1e-3),
                floor=1e-6,
            ),
            GuardedFigure(
                "press_fredholm_force_rel",
                "contact force of a ball on a bonded layer against the Fredholm equation: "
                "relative error",
                target=Target(high=3e-3),
                floor=2e-5,
            ),
            GuardedFigure(
                "press_large_strain_face_um",
                "face of a bonded pad against a neo-Hookean solid: RMS difference, um",
                target=Target(high=5),
                floor=1e-2,
            ),
        ),
        other.press,
    ),
    BenchmarkCase(
        "fem",
        "other mesh in every run",
        (
            GuardedFigure(
                "fem_face_um",
                "height of the coat against 3-D finite elements: largest difference, um",
                headline=True,
                target=Target(high=3),
                floor=0.25,
            ),
        ),
        other.fem,
        quick=False,
    ),
    BenchmarkCase(
        "photons",
        "3 seeds",
        (
            GuardedFigure(
                "photons_energy_gap_rel",
                "light into the clear brick that is not accounted for: share",
                target=Target(high=0.01),
                floor=1e-5,
            ),
        ),
        other.photons,
        quick=False,
    ),
    BenchmarkCase(
        "gelsight",
        "4 seeds, 5 places each",
        (
            # Real presses of the same sensor, n = 29, and their spread: docs/photometric.md.
            rendered(
                "gelsight_cap_corrected",
                "GelSight-like sensor: measured over true height of a ball, exact integration",
                headline=True,
                target=Target.about(1.007, 0.05),
            ),
            rendered(
                "gelsight_cap_faithful_2025",
                "GelSight-like sensor: measured over true height of a ball, integrated as by "
                "the vendor in 2025",
                target=Target.about(0.66, 0.035),
            ),
            rendered(
                "gelsight_cap_faithful_2024",
                "GelSight-like sensor: measured over true height of a ball, integrated as by "
                "the vendor in 2024",
                target=Target.about(1.32, 0.07),
            ),
        ),
        other.gelsight,
        quick=False,
    ),
)

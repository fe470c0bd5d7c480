"""What a comparison says in numbers: one column per method, and decoders against contact-FPP."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any

from twin.config.models import Experiment
from twin.report.direct import percent
from twin.report.fields import NONE, number
from twin.report.paper import paper_rmse_ratio
from twin.report.photometric_maps import decoder_name
from twin.results.decoders import DecodedImage
from twin.results.record import Colours, Measurement
from twin.results.score import SphereScore

ROWS = (
    "force of the press (N)",
    "depth of the press (mm)",
    "relief peak of the coat (mm)",
    "points on",
    "good points",
    "z error, RMS (µm)",
    "z error, mean (µm)",
    "z error, P95 (µm)",
    "wrong fringe orders",
    "saturated pixel values",
    "exposure (ms)",
    "sphere radii (mm)",
    "of the true surface (mm)",
    "sphere-fit RMSE (µm)",
    "of the true surface (µm)",
)
"""Labels of the table under each specimen, in the order of `values`."""


@dataclass(frozen=True)
class RatioRow:
    """Sphere-fit RMSE of one decoder, in itself and over that of contact-FPP."""

    name: str
    rmse_um: str
    ratio: str
    z_rmse_um: str


@dataclass(frozen=True, eq=False)
class Gist:
    """What is compared across methods; without the frames, which take 600 MB at full size."""

    experiment: Experiment
    figures: dict[str, Any]
    spheres: tuple[SphereScore, ...]
    decoded: list[DecodedImage]


def gist_of(measured: Measurement) -> Gist:
    """Return what is compared across methods."""
    images = measured.images
    decoded = images.decoded if isinstance(images, Colours) else []
    return Gist(measured.experiment, measured.figures, measured.score.spheres, decoded)


def values(measured: Measurement) -> list[str]:
    """Return one column of the table, in the order of ROWS."""
    figures = measured.figures
    limit_um = measured.experiment.score.good_within_um
    return [
        *_press(measured),
        percent(figures["completeness"]),
        f"{percent(figures['good_share'])} ({limit_um:g} µm)",
        *(number(figures[name], ".2f") for name in ("z_rmse_um", "z_bias_um", "z_p95_um")),
        *_fringes(measured),
        *_spheres(measured),
    ]


def press_in_words(methods: dict[str, Gist | None]) -> str:
    """Say how the presses of coat and gel compare; empty where only one is pressed.

    Parameters
    ----------
    methods : measurement by method, None where it failed
    """
    if not {"contact_fpp", "photometric_stereo"} <= set(methods):
        return ""
    coat, gel = methods["contact_fpp"], methods["photometric_stereo"]
    if coat is None or gel is None:
        return (
            "The two coats could not be brought to one press: what failed is told below, and the "
            "other is shown alone."
        )
    (force_coat, force_gel), (depth_coat, depth_gel) = (
        (coat.figures[name], gel.figures[name]) for name in ("force_n", "depth_mm")
    )
    if coat.experiment.elastomer == gel.experiment.elastomer:
        return f"One gel, one press: {depth_coat:.3g} mm deep with {force_coat:.3g} N."
    told = (
        f"contact-FPP is pressed {depth_coat:.3g} mm deep with {force_coat:.3g} N, photometric "
        f"stereo {depth_gel:.3g} mm with {force_gel:.3g} N."
    )
    if _alike(force_coat, force_gel):
        moduli = " and ".join(f"{one.figures['young_modulus_kpa']:.3g}" for one in (coat, gel))
        return (
            f"The same force, two elastomers: {told} At one force the depth follows from layout, "
            f"thickness and Young's modulus ({moduli} kPa)."
        )
    shared = "The same depth, two elastomers" if _alike(depth_coat, depth_gel) else "Not one press"
    return f"{shared}: {told}"


def ratio_rows(methods: dict[str, Gist | None]) -> list[RatioRow]:
    """Return every decoder's sphere-fit RMSE over contact-FPP's, and the paper's; or none."""
    coat, gel = methods.get("contact_fpp"), methods.get("photometric_stereo")
    if coat is None or gel is None or not gel.decoded or not coat.spheres:
        return []
    base_mm = _mean_rmse_mm(coat.spheres)
    base = f"{1e3 * base_mm:.2f}", "1", number(coat.figures["z_rmse_um"], ".1f")
    rows = [RatioRow("contact-FPP", *base)]
    for one in gel.decoded:
        found_mm = one.sphere_rmse_mm
        if found_mm is not None:
            found = f"{1e3 * found_mm:.2f}", f"{found_mm / base_mm:.1f}"
            rows.append(RatioRow(decoder_name(one), *found, f"{one.errors.z_rmse_um:.1f}"))
    published = paper_rmse_ratio(gel.experiment)
    if published is not None:
        rows.append(RatioRow("paper, GelSight over contact-FPP", NONE, f"{published:.1f}", NONE))
    return rows


def ratio_in_words(methods: dict[str, Gist | None]) -> str:
    """Say plainly how far photometric stereo is from contact-FPP on the paper's artefact.

    Empty for other specimens, and where one of both is not there.
    """
    coat, gel = methods.get("contact_fpp"), methods.get("photometric_stereo")
    if coat is None or gel is None or not coat.spheres or not gel.decoded:
        return ""
    published = paper_rmse_ratio(gel.experiment)
    found_mm = [one.sphere_rmse_mm for one in gel.decoded]
    if published is None or None in found_mm:
        return ""
    ratios = [mm / _mean_rmse_mm(coat.spheres) for mm in found_mm if mm is not None]
    closer = sum(ratio < published for ratio in ratios)
    told = {
        0: "no decoder comes as close as the paper's",
        len(ratios): "every decoder is closer to contact-FPP than the paper's",
    }.get(closer, f"{closer} of {len(ratios)} decoders are closer to contact-FPP than the paper's")
    return (
        f"Sphere-fit RMSE of photometric stereo over that of contact-FPP: {min(ratios):.1f} to "
        f"{max(ratios):.1f} by decoder; the paper reports {published:.1f}: {told}."
    )


def _alike(first: float, second: float) -> bool:
    # A force carried over is rounded to four digits; solvers meet it to better than 0.1 %.
    return abs(first - second) <= 2e-3 * max(abs(first), abs(second))


def _mean_rmse_mm(spheres: Sequence[SphereScore]) -> float:
    return mean(ball.measured.stats.rmse_mm for ball in spheres)


def _press(measured: Measurement) -> list[str]:
    if measured.pressed is None:
        return [NONE] * 3
    return [f"{measured.figures[name]:.3g}" for name in ("force_n", "depth_mm", "relief_peak_mm")]


def _fringes(measured: Measurement) -> list[str]:
    figures = measured.figures
    if isinstance(measured.images, Colours):
        exposure_ms = measured.experiment.camera.exposure_ms
        shown = f"{exposure_ms:.3g}" if isinstance(exposure_ms, float) else str(exposure_ms)
        return [NONE, NONE, shown]
    return [
        number(figures["wrong_order_pixels"], "d"),
        f"{figures['saturated_share']:.2%}",
        f"{figures['exposure_ms']:.3g}",
    ]


def _spheres(measured: Measurement) -> list[str]:
    balls = measured.score.spheres
    found, true = [ball.measured for ball in balls], [ball.true_face for ball in balls]
    return [
        ", ".join(text) or NONE
        for text in (
            [f"{fit.radius_mm:.3f}" for fit in found],
            [f"{fit.radius_mm:.3f}" for fit in true],
            [f"{1e3 * fit.stats.rmse_mm:.2f}" for fit in found],
            [f"{1e3 * fit.stats.rmse_mm:.2f}" for fit in true],
        )
    ]

"""The experiment in a report: summary, result in words, and the appendix."""

from collections.abc import Mapping
from typing import Any

from reconstruction.codes import code_of
from reconstruction.decoding import Weights
from reconstruction.patterns import AXES
from twin.config.models import NoiseModel, Specimen
from twin.optics.rig import true_calibration
from twin.report.page import CollapsedSection, Grade, Section, TwoColumns
from twin.report.settings import settings_blocks
from twin.report.table import Table, pairs, parts
from twin.report.words import coating_phrase, in_words, label_of, percent, phrase
from twin.results.decoders import decoder_name
from twin.results.layout import layout_figures
from twin.results.record import Measurement

# Shortest duration that is written in seconds.
_LEAST_IN_SECONDS_MS = 1e4


def glance(measured: Measurement) -> Table:
    """Return the table that summarises the experiment, one row per part.

    The rows are specimen, coat or stage, camera and light with their settings, and the digest.
    """
    method = measured.experiment.method
    return parts(
        "experiment",
        [
            ("specimen", _specimen(measured)),
            *(_coat(measured) if method.presses else _stage(measured)),
            *(_fringes(measured) if method.fringes else _colours(measured)),
            ("digest", measured.digest),
        ],
    )


def _fringes(measured: Measurement) -> list[tuple[str, str]]:
    return [
        ("camera", _camera(measured)),
        ("projector", _projector(measured)),
        ("patterns", _patterns(measured)),
        ("layout", _layout(measured)),
        ("exposure", _exposure(measured)),
        ("decoding", _decoding(measured)),
    ]


def _layout(measured: Measurement) -> str:
    figures = layout_figures(measured.experiment)
    depth_mm, baseline_mm = figures.get("depth_of_field_mm"), figures.get("baseline_mm")
    return (
        f"field {figures['field_width_mm']:.3g} × {figures['field_height_mm']:.3g} mm from "
        f"{figures['working_distance_mm']:.3g} mm, magnification {figures['magnification']:.3g}"
        + (f", depth of field {depth_mm:.3g} mm" if depth_mm else "")
        + f", Airy radius {figures['diffraction_um']:.2g} µm"
        + (f"; baseline {baseline_mm:.3g} mm" if baseline_mm else "")
    )


def _exposure(measured: Measurement) -> str:
    figures = measured.figures
    text = f"{figures['exposure_ms']:.3g} ms per frame"
    # Results of earlier versions have no duration.
    duration_ms = figures.get("sequence_ms")
    if duration_ms is None:
        return text
    is_long = duration_ms >= _LEAST_IN_SECONDS_MS
    duration = f"{1e-3 * duration_ms:.4g} s" if is_long else f"{duration_ms:.4g} ms"
    return f"{text}, {duration} for all frames"


def _colours(measured: Measurement) -> list[tuple[str, str]]:
    size, plan = measured.experiment.photometric, measured.experiment.photometric.presses
    return [
        (
            "image",
            f"{size.width_px} × {size.height_px} px of {1e3 * measured.pixel_mm:.1f} µm on "
            f"the coat, 8-bit RGB, gamma {size.gamma:g}; evaluated field {size.field_x_mm:g} × "
            f"{size.field_y_mm:g} mm",
        ),
        (
            "calibration",
            f"{plan.count} rendered presses of balls of {plan.smallest_diameter_mm:g} to "
            f"{plan.largest_diameter_mm:g} mm, {plan.backgrounds} images without contact",
        ),
        ("decoding", decoder_name(measured.colours.own)),
    ]


def _specimen(measured: Measurement) -> str:
    specimen = measured.experiment.specimen
    if specimen.components:
        parts = (f"{name} ({_shape(part)})" for name, part in specimen.components.items())
        return f"group: {'; '.join(parts)}"
    return _shape(specimen)


def _shape(specimen: Specimen) -> str:
    values = specimen.model_dump()
    kind = str(values.pop("kind")).replace("_", " ")
    values.pop("material", None)
    # Zeros of the default pose are omitted.
    stated = {name: value for name, value in values.items() if value}
    return f"{kind}: {phrase(stated)}" if stated else kind


def _coat(measured: Measurement) -> list[tuple[str, str]]:
    experiment = measured.experiment
    return [
        ("press", _press(measured)),
        ("elastomer", _elastomer(measured)),
        ("coating", coating_phrase(experiment.coating)),
    ]


def _stage(measured: Measurement) -> list[tuple[str, str]]:
    material, stage = measured.experiment.specimen.material, measured.experiment.stage
    assert material is not None  # the renderer requires a material
    return [
        ("material", f"{material.kind}: {phrase(material.model_dump(exclude={'kind'}))}"),
        ("stage", f"matte: {phrase(stage.model_dump())}"),
    ]


def _press(measured: Measurement) -> str:
    figures, back_kpa = measured.figures, measured.experiment.press.back_pressure_kpa
    behind = f", {back_kpa:g} kPa on the coated face" if back_kpa else ""
    return (
        f"{measured.experiment.press.control} controlled: {figures['depth_mm']:.3g} mm deep with "
        f"{figures['force_n']:.3g} N{behind}; relief peak {figures['relief_peak_mm']:.3g} mm"
    )


def _elastomer(measured: Measurement) -> str:
    stated = measured.experiment.elastomer.model_dump(exclude={"young_modulus_kpa"})
    modulus_kpa = float(f"{measured.figures['young_modulus_kpa']:.3g}")
    return phrase(stated | {"young_modulus_kpa": modulus_kpa})


def _camera(measured: Measurement) -> str:
    camera = measured.experiment.camera
    width, height = camera.width_px // camera.binning, camera.height_px // camera.binning
    pixel_um = 1e3 * measured.pixel_mm
    return (
        f"{width} × {height} px ({camera.binning} × {camera.binning} binning), "
        f"{camera.focal_length_mm:.4g} mm f/{camera.f_number:.3g}, {camera.bit_depth} bit, "
        f"{camera.full_well_e:g} e⁻ full well, {camera.read_noise_e:g} e⁻ read noise"
        f"{_noise(camera.noise_model)}; {pixel_um:.1f} µm per pixel on the face"
    )


def _noise(model: NoiseModel) -> str:
    """Return kind and numbers of camera noise other than that of EMVA 1288."""
    if model.is_emva1288:
        return ""
    return f", noise {model.kind}: {phrase(model.model_dump(exclude={'kind'}))}"


def _projector(measured: Measurement) -> str:
    projector = measured.experiment.projector
    return (
        f"{projector.width_px} × {projector.height_px} px, throw ratio {projector.throw_ratio:g}, "
        f"{projector.flux_mw:g} mW at {projector.wavelength_nm:g} nm, "
        f"{true_calibration(measured.experiment).triangulation_angle_deg:.1f}° from the camera"
    )


def _patterns(measured: Measurement) -> str:
    patterns = measured.experiment.patterns
    code = code_of(patterns.code).title
    if patterns.further_periods_px:
        code += " of " + in_words(patterns.further_periods_px) + " px"
    both = len(patterns.axes) == len(AXES)
    along = "in both directions" if both else f"along the projector's {patterns.axes[0]}s"
    first = f"{patterns.steps} phase steps of" if patterns.steps else "no fringes, words of"
    shown = [f"{first} {patterns.period_px:g} px {along}", code]
    shown += [f"stepping {patterns.stepping}"] * (patterns.stepping != "equal")
    shown += [f"{patterns.waveform} fringes"] * (patterns.waveform != "sinusoidal")
    shown += ["inverse frames"] * patterns.inverse + ["white", "black"] * patterns.uniform
    return f"{', '.join(shown)}: {in_words(measured.figures.get('frames'))} frames"


_FILTERED: dict[Weights, str] = {
    "equal": "on the coordinate",
    "modulation": "on the phase, weighted by modulation",
}


def _decoding(measured: Measurement) -> str:
    decode = measured.experiment.decode
    smoothed = (
        f"Gaussian of {decode.filter_taps} × {decode.filter_taps} px, σ {decode.filter_sigma_px:g} "
        f"px, {_FILTERED[decode.weights]}"
        if decode.filter_taps
        else "no filter"
    )
    return f"{smoothed}; depth from {decode.use}"


GOOD_SHARE, POOR_SHARE = 0.95, 0.5


def grade_of_share(share: float) -> Grade:
    """Return the grade for a share (0 to 1) of the scored pixels that have a good point."""
    measured: Grade = "good" if share >= GOOD_SHARE else "check"
    return "poor" if share < POOR_SHARE else measured


def result_in_words(measured: Measurement) -> str:
    """Return a sentence with the share of the scored pixels that have a good point."""
    method, share = measured.experiment.method, measured.figures["good_share"]
    surface = "specimen's visible area"
    if method.presses:
        surface = "lit coat" if method.fringes else "coat in the evaluated field"
    if share is None:
        return f"No camera pixel shows the {surface}."
    limit_um = measured.experiment.score.good_within_um
    return f"{percent(share)} of the {surface} has a point within {limit_um:g} µm."


def appendix(measured: Measurement) -> Section:
    """Return the collapsed appendix: settings, metrics, times per stage, versions."""
    experiment = measured.experiment
    times = [(name, f"{value:.2f}", "s") for name, value in measured.seconds.items()]
    versions = [(name, str(value), "") for name, value in measured.versions.items()]
    return Section(
        "appendix",
        "Appendix",
        (
            CollapsedSection(
                "All settings that the method reads, with their sources",
                settings_blocks(experiment),
            ),
            CollapsedSection(
                "All metrics, time per stage, versions",
                (
                    TwoColumns(
                        (pairs("metrics", "Metrics", _metrics(measured.metrics)),),
                        (
                            *([pairs("timings", "Time per stage", times)] if times else []),
                            pairs("versions", "Versions", versions),
                        ),
                    ),
                ),
            ),
        ),
    )


def _metrics(figures: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return label, value and unit of each metric in result.json, except the warnings.

    The warnings are shown at the head of the report.
    """
    rows = []
    for name, value in figures.items():
        if name != "warnings":
            label, unit = label_of(name)
            rows.append((label, in_words(value), unit))
    return rows

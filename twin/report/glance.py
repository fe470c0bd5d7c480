"""The experiment at a glance: one line per part of the sensor."""

from twin.optics.light import pattern_set
from twin.report.fields import coating_phrase, in_words, phrase
from twin.report.rig import triangulation_angle_deg
from twin.report.world_map import pixel_on_face_mm
from twin.results.record import Measurement

_CODE_WORDS = {
    "gray": "Gray code",
    "complementary_gray": "complementary Gray code",
    "shifted_gray": "shifted Gray code",
    "hierarchical": "hierarchical periods",
    "heterodyne": "heterodyne periods",
}


def glance(scored: Measurement) -> list[tuple[str, str]]:
    """Return (part, description) pairs."""
    direct = not scored.experiment.method.presses
    return [
        ("specimen", _specimen(scored)),
        *(_stage(scored) if direct else _coat(scored)),
        ("camera", _camera(scored)),
        ("projector", _projector(scored)),
        ("patterns", _patterns(scored)),
        ("exposure", f"{scored.figures['exposure_ms']:.3g} ms per frame"),
        ("decoding", _decoding(scored)),
        ("digest", scored.digest),
    ]


def _specimen(scored: Measurement) -> str:
    values = scored.experiment.specimen.model_dump(exclude={"kind", "material"})
    # A pose of zeros says nothing; a moved or turned specimen is told in full.
    told = {name: value for name, value in values.items() if value}
    return f"{scored.experiment.specimen.kind.replace('_', ' ')}: {phrase(told)}"


def _coat(scored: Measurement) -> list[tuple[str, str]]:
    experiment = scored.experiment
    return [
        ("press", _press(scored)),
        ("elastomer", f"{phrase(experiment.elastomer.model_dump())}; {_modulus(scored)}"),
        ("coating", coating_phrase(experiment.coating)),
    ]


def _stage(scored: Measurement) -> list[tuple[str, str]]:
    material, stage = scored.experiment.specimen.material, scored.experiment.stage
    assert material is not None  # or nothing would have been rendered
    return [
        ("material", f"{material.kind}: {phrase(material.model_dump(exclude={'kind'}))}"),
        ("stage", f"matte: {phrase(stage.model_dump())}"),
    ]


def _press(scored: Measurement) -> str:
    figures, back_kpa = scored.figures, scored.experiment.press.back_pressure_kpa
    behind = f", {back_kpa:g} kPa on the coated face" if back_kpa else ""
    return (
        f"{scored.experiment.press.control} controlled: {figures['depth_mm']:.3g} mm deep with "
        f"{figures['force_n']:.3g} N{behind}; relief peak {figures['relief_peak_mm']:.3g} mm"
    )


def _modulus(scored: Measurement) -> str:
    return f"Young's modulus {scored.figures['young_modulus_kpa']:.3g} kPa"


def _camera(scored: Measurement) -> str:
    camera = scored.experiment.camera
    width, height = camera.width_px // camera.binning, camera.height_px // camera.binning
    pixel_um = 1e3 * pixel_on_face_mm(scored.experiment)
    return (
        f"{width} × {height} px ({camera.binning} × {camera.binning} binning), "
        f"{camera.focal_length_mm:g} mm f/{camera.f_number:g}, {camera.bit_depth} bit, "
        f"{camera.full_well_e:g} e⁻ full well, {camera.read_noise_e:g} e⁻ read noise; "
        f"{pixel_um:.1f} µm per pixel on the face"
    )


def _projector(scored: Measurement) -> str:
    projector = scored.experiment.projector
    return (
        f"{projector.width_px} × {projector.height_px} px, throw ratio {projector.throw_ratio:g}, "
        f"{projector.flux_mw:g} mW at {projector.wavelength_nm:g} nm, "
        f"{triangulation_angle_deg(scored.experiment):.1f}° from the camera"
    )


def _patterns(scored: Measurement) -> str:
    patterns = scored.experiment.patterns
    code = _CODE_WORDS[str(pattern_set(scored.experiment.projector, patterns).code)]
    if patterns.further_periods_px:
        code += " of " + in_words(patterns.further_periods_px) + " px"
    return (
        f"{patterns.steps} phase steps of {patterns.period_px:g} px in both directions, {code}, "
        f"white, black: {scored.figures.get('frames', '?')} frames"
    )


def _decoding(scored: Measurement) -> str:
    decode = scored.experiment.decode
    smoothed = (
        f"Gaussian of {decode.filter_taps} × {decode.filter_taps} px, σ {decode.filter_sigma_px:g} "
        "px, on the coordinate"
        if decode.filter_taps
        else "no filter"
    )
    return f"{smoothed}; depth from {decode.use}"

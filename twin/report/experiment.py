"""The experiment in a report: summary, side view of the rig, and every setting with its source.

The side view is projected onto the vertical plane through camera and projector. Its horizontal
coordinate s, mm, is 0 at the world origin.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull

from reconstruction.arrays import FloatArray
from reconstruction.codes import code_of
from reconstruction.decoding import Weights
from reconstruction.patterns import AXES
from reconstruction.rig.pinhole import Pinhole
from twin.config.models import Experiment, NoiseModel, Provenance, Specimen
from twin.config.quantities import value_at
from twin.optics.rig import true_calibration
from twin.report.canvas import FIT, INK, MEASURED, NOMINAL, axes_at, chart, drawing
from twin.report.page import Block, CollapsedSection, Figure, Grade, Section, TwoColumns
from twin.report.table import Column, Table, pairs, parts
from twin.report.words import coating_phrase, in_words, label_of, percent, phrase, split_unit
from twin.results.decoders import decoder_name
from twin.results.layout import layout_figures
from twin.results.record import Measurement
from twin.specimens import shape_of

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


_HEAD = ("schema_version", "name", "description", "provenance", "links")
_OF_COATS = {"elastomer", "coating", "press", "mechanics", "layers"}
_OF_FRINGES = {"projector", "patterns", "decode"}
_OF_LAMPS = {"lamps", "photometric"}
_NO_SOURCE = "set in the experiment, or default"


@dataclass(frozen=True)
class Setting:
    """One value of the experiment with its source.

    Attributes
    ----------
    section : first part of `path`, for example "camera"
    path : key for `--set`
    source : source of the value; empty if none is stated
    range : valid range as text; empty if none is stated
    assumed : True if the source states that the value is assumed
    """

    section: str
    path: str
    value: str
    unit: str
    source: str
    range: str
    assumed: bool


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


def settings_blocks(experiment: Experiment) -> tuple[Block, ...]:
    """Return the tables of the settings that the experiment's method reads.

    Settings without a stated source are in a collapsed section. The file `experiment.toml` contains
    all settings, including those for other methods.
    """
    settings = settings_of(experiment)
    sourced = [setting for setting in settings if setting.source]
    plain = [replace(setting, source=_NO_SOURCE) for setting in settings if not setting.source]
    folded = CollapsedSection(
        f"{len(plain)} settings without a stated source (set in the experiment, or defaults)",
        (_settings_table("plain_settings", plain),),
    )
    return (_settings_table("settings", sourced), folded)


def _settings_table(name: str, settings: Sequence[Setting]) -> Table:
    return Table(
        name,
        "",
        "",
        (
            Column("path", "setting (as --set takes it)", kind="code"),
            Column("value", "value", kind="number"),
            Column("unit", "unit", kind="unit"),
            Column("source", "source"),
            Column("range", "valid range", kind="range"),
        ),
        tuple(
            {
                "path": setting.path,
                "value": setting.value,
                "unit": setting.unit,
                "source": _marked(setting),
                "range": setting.range,
                "section": setting.section,
            }
            for setting in settings
        ),
        (
            "Shaded values are assumed: no source states them. Replace them by measured values "
            "before you rely on results that depend on them.",
        ),
        kinds=tuple("assumed" if setting.assumed else "" for setting in settings),
        group="section",
        look="settings",
    )


def settings_of(experiment: Experiment) -> list[Setting]:
    """Return the settings that the experiment's method reads, in the order of the experiment.

    They include values with a source that are at their default and that digests exclude.
    """
    tree = experiment.model_dump(mode="json", exclude={*_HEAD, *_without_meaning(experiment)})
    for path in experiment.provenance:
        parent, _, name = path.rpartition(".")
        node = tree if not parent else value_at(tree, parent)
        if isinstance(node, dict) and name not in node:
            node[name] = value_at(experiment, path)
    return [_setting(path, value, experiment.provenance.get(path)) for path, value in _leaves(tree)]


def _without_meaning(experiment: Experiment) -> set[str]:
    """Return the names of the sections that the experiment's method does not read."""
    method = experiment.method
    pressed = {"stage"} if method.presses else _OF_COATS
    return pressed | (_OF_LAMPS if method.fringes else _OF_FRINGES)


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


def _marked(setting: Setting) -> str:
    if not setting.assumed:
        return setting.source
    source = setting.source.removeprefix("assumed").removeprefix(":")
    return Markup('<span class="tag">assumed</span> {}').format(source)


def _leaves(node: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for setting in value:
                yield from _leaves(setting, f"{prefix}{key}.{setting.get('name', '')}.")
        elif value is not None:
            yield f"{prefix}{key}", value


def _setting(path: str, value: Any, origin: Provenance | None) -> Setting:
    _, unit = split_unit(path)
    allowed = f"{origin.range[0]:g} to {origin.range[1]:g}" if origin and origin.range else ""
    return Setting(
        section=path.split(".")[0] if "." in path else "experiment",
        path=path,
        value=in_words(value),
        unit=unit,
        source=origin.source if origin else "",
        range=allowed,
        assumed=origin is not None and origin.source.startswith("assumed"),
    )


def rig_figure(measured: Measurement) -> Figure:
    """Return the figure with the side view of the rig."""
    return Figure(
        "rig",
        "Side view of the rig",
        "Camera, projector and their fields of view, projected onto the vertical plane through "
        "both devices; lengths in mm, to scale. The elastomer should be inside both fields.",
        "side view of camera, projector and elastomer",
        lambda path: draw_rig(path, measured.experiment),
    )


def draw_rig(path: Path, experiment: Experiment) -> None:
    """Draw the side view of the rig as PNG."""
    rig = true_calibration(experiment)
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    across = _horizontal(projector - camera)
    with drawing(path, 5.0, 4.8) as figure:
        axes = axes_at(figure, 0.6, 0.35, 4.1, 3.9)
        for name, device, pose, colour in (
            ("camera", rig.camera, rig.T_world_from_cam, MEASURED),
            ("projector", rig.projector, rig.T_world_from_proj, FIT),
        ):
            _fan(axes, device, pose, across, colour)
            _device(axes, name, pose[:3, 3], across, colour)
        _slab_and_specimen(axes, experiment, across)
        angle_deg = rig.triangulation_angle_deg
        chart(
            axes,
            f"Side view to scale; {angle_deg:.1f}° between the devices",
            "along the baseline (mm)",
            "z (mm)",
            aspect="equal",
        )
        axes.margins(x=0.09, y=0.16)


def _horizontal(baseline_mm: FloatArray) -> FloatArray:
    length = float(np.hypot(*baseline_mm[:2]))
    return np.array([*baseline_mm[:2] / length, 0.0]) if length > 1e-9 else np.array([1.0, 0, 0])


def _flat(points_world_mm: FloatArray, across: FloatArray) -> FloatArray:
    """Return the coordinates (n, 2) in the side view, s and z, of world points (n, xyz), mm."""
    return np.stack([points_world_mm @ across, points_world_mm[:, 2]], axis=1)


def _fan(axes: Axes, device: Pinhole, pose: FloatArray, across: FloatArray, colour: str) -> None:
    """Draw a device's field of view as an area from its pinhole to the undeformed face z = 0."""
    rays = np.column_stack([device.seen_corners(), np.ones(4)]) @ pose[:3, :3].T
    # A grazing ray intersects the plane far away; the drawing ends at 2 x the standoff.
    reach = np.where(rays[:, 2] < 0, pose[2, 3] / np.maximum(-rays[:, 2], 1e-9), np.inf)
    reach = np.minimum(reach, 2 * float(np.linalg.norm(pose[:3, 3])))
    ends = pose[:3, 3] + reach[:, None] * rays
    outline = _flat(np.vstack([pose[:3, 3], ends]), across)
    hull: Any = ConvexHull(outline)
    axes.add_patch(Polygon(outline[hull.vertices], facecolor=colour, alpha=0.13, edgecolor="none"))
    centre = _flat(np.stack([pose[:3, 3], np.zeros(3)]), across)
    axes.plot(centre[:, 0], centre[:, 1], color=colour, lw=0.9, ls="--")


def _device(axes: Axes, name: str, centre_mm: FloatArray, across: FloatArray, colour: str) -> None:
    s, z = _flat(centre_mm[None], across)[0]
    axes.plot([s], [z], marker="s", ms=9, color=colour)
    axes.annotate(
        f"{name}\ndistance {np.linalg.norm(centre_mm):.0f} mm",
        (s, z),
        xytext=(0, 9),
        textcoords="offset points",
        ha="center",
        va="bottom",
        color=colour,
    )


def _slab_and_specimen(axes: Axes, experiment: Experiment, across: FloatArray) -> None:
    slab = experiment.elastomer
    half = (abs(across[0]) * slab.length_x_mm + abs(across[1]) * slab.length_y_mm) / 2
    corners = [(-half, -slab.thickness_mm), (half, -slab.thickness_mm), (half, 0), (-half, 0)]
    axes.add_patch(Polygon(corners, facecolor="#9cc4de", edgecolor=INK, lw=0.7))
    for ball in shape_of(experiment.specimen).spheres():
        s, z = _flat(np.array([[ball.x_mm, ball.y_mm, ball.z_mm]]), across)[0]
        centre = (s, z - slab.thickness_mm)
        axes.add_patch(Circle(centre, ball.radius_mm, facecolor="#d9cdb8", edgecolor=NOMINAL))
    axes.annotate(
        "elastomer over specimen",
        (half, -slab.thickness_mm / 2),
        xytext=(8, -4),
        textcoords="offset points",
        va="top",
    )

"""Sliders of the live view: the numbers of an experiment that a designer changes, with ranges."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.config import Experiment

EXPOSURE = "camera.exposure_ms"
STEPS = 100
_HIGHEST_PRESSURE_KPA = 3.0
# A stated source may allow values up to 100 times the current one: too many for a slider's steps.
_LARGEST_RATIO = 4.0


@dataclass(frozen=True)
class SliderRange:
    """A slider of the live view: one number of the experiment with its range.

    Attributes
    ----------
    group : heading of the slider
    key : dotted path of the number, as `twin keys` lists it
    label : name with unit
    low, high, value : ends of the slider, and current value
    """

    group: str
    key: str
    label: str
    low: float
    high: float
    value: float

    @property
    def step(self) -> float:
        """Smallest change of the value."""
        return (self.high - self.low) / STEPS


# group, key, label, largest change from the current value
_MOVED: tuple[tuple[str, str, str, float], ...] = (
    ("elastomer", "elastomer.thickness_mm", "thickness (mm)", 0.5),
    ("elastomer", "elastomer.shore_a", "hardness (Shore A)", 0.5),
    ("elastomer", "elastomer.shore_00", "hardness (Shore 00)", 0.5),
    ("elastomer", "elastomer.young_modulus_kpa", "Young's modulus (kPa)", 0.5),
    ("press", "press.depth_mm", "travel (mm)", 0.5),
    ("press", "press.force_n", "force (N)", 0.8),
    ("press", "press.back_pressure_kpa", "air pressure (kPa)", 1.0),
    ("coating", "coating.base_albedo", "albedo", 0.5),
    ("coating", "coating.flake_fraction", "flakes (share)", 1.0),
    ("coating", "coating.flake_roughness", "flake roughness", 0.5),
    ("fringes", "patterns.period_px", "period (px)", 0.5),
    ("camera", "camera.pose.polar_deg", "tilt (deg)", 20.0),
    ("camera", "camera.pose.standoff_mm", "distance (mm)", 0.3),
    ("camera", EXPOSURE, "exposure (ms)", 0.9),
    ("projector", "projector.pose.polar_deg", "tilt (deg)", 20.0),
    ("projector", "projector.pose.azimuth_deg", "direction (deg)", 45.0),
    ("projector", "projector.pose.standoff_mm", "distance (mm)", 0.3),
    ("specimen", "specimen.x_mm", "x (mm)", 4.0),
    ("specimen", "specimen.y_mm", "y (mm)", 4.0),
    ("specimen", "specimen.yaw_deg", "rotation (deg)", 90.0),
    ("specimen", "specimen.tilt_deg", "tilt (deg)", 10.0),
)
GROUPS = tuple(dict.fromkeys(group for group, *_ in _MOVED))
"""Headings of the sliders, in the order of the panel."""
# The largest change of these is absolute, of all others relative to the value.
_ABSOLUTE = ("polar_deg", "azimuth_deg", "x_mm", "y_mm", "yaw_deg", "tilt_deg")
_NOT_NEGATIVE = ("polar_deg",)
_SHARES = ("albedo", "fraction", "roughness")


def slider_ranges(experiment: Experiment, exposure_ms: float | None = None) -> list[SliderRange]:
    """Return the sliders of an experiment.

    The range of a slider is that of the value's stated source, limited to 4 times the current value
    of a load, of the fringe period or of a property of the elastomer. Without a source it is an
    interval round the value. The range always includes the value.

    Parameters
    ----------
    exposure_ms : current value of an automatic exposure; None: no slider for such an exposure
    """
    tree = experiment.model_dump()
    if experiment.camera.exposure_ms == "auto":
        tree["camera"]["exposure_ms"] = exposure_ms
    sliders = [_slider(experiment, tree, entry) for entry in _MOVED]
    return [slider for slider in sliders if slider is not None]


def _slider(
    experiment: Experiment, tree: Mapping[str, Any], entry: tuple[str, str, str, float]
) -> SliderRange | None:
    group, key, label, reach = entry
    value: Any = tree
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or key in experiment.links:
        return None
    low, high = (_rounded(end) for end in _ends(experiment, key, float(value), reach))
    shown = float(f"{value:.6g}")
    if high <= low:
        return None
    return SliderRange(group, key, label, min(low, shown), max(high, shown), shown)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _ends(experiment: Experiment, key: str, value: float, reach: float) -> tuple[float, float]:
    origin = experiment.provenance.get(key)
    if origin is not None and origin.range is not None:
        return _within_ratio(key, value, *origin.range)
    if key == "press.back_pressure_kpa":
        return _pressures_kpa(experiment, value)
    step = reach if key.endswith(_ABSOLUTE) else reach * value
    low = max(value - step, 0.0) if key.endswith(_NOT_NEGATIVE) else value - step
    return low, min(value + step, 1.0) if key.endswith(_SHARES) else value + step


def _within_ratio(key: str, value: float, low: float, high: float) -> tuple[float, float]:
    if key.startswith(("elastomer.", "press.", "patterns.")) and value > 0:
        least = value / _LARGEST_RATIO if key.startswith("patterns.") else low
        return max(float(low), least), min(float(high), _LARGEST_RATIO * value)
    return float(low), float(high)


def _pressures_kpa(experiment: Experiment, value: float) -> tuple[float, float]:
    """Return the range of the air pressure; empty for an elastomer that is no thin sheet."""
    from twin.mechanics.choice import may_wrap

    wraps = may_wrap(experiment.elastomer)
    return 0.0, max(2.0 * value, _HIGHEST_PRESSURE_KPA) if wraps else 0.0

"""Which instrument a method takes to a specimen, and how it is pressed so that results compare.

Fringes are projected by the experiment's own rig. Photometric stereo is another sensor with another
gel: specimen, scoring and load of the experiment are carried over to a rig of its own. The load is
the force by default, as two sensors on one press would feel it. The same depth is another
comparison: a gel bonded to a window resists far more than a free sheet.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from reconstruction.errors import InputError
from twin.config import Experiment, load_experiment, vary
from twin.config.loading import validate_experiment
from twin.config.methods import TRAITS, Method
from twin.config.models import Press, Provenance
from twin.pipeline.press import press_specimen

Match = Literal["force", "depth"]

# Digits kept of a force that was computed: the last ones of the finite-element model vary.
_FORCE_DIGITS = 4
# Not the seed: all specimens meet one sensor, whose noise and reference presses are the rig's.
_CARRIED = ("name", "description", "specimen", "stage", "score")
_LOAD = ("control", "depth_mm", "force_n")


@dataclass(frozen=True)
class PhotometricPlan:
    """Which sensor stands for photometric stereo, and what its press has in common.

    Attributes
    ----------
    rig : TOML file without specimen, or the name of a shipped rig
    settings : values by dotted path laid over the rig
    match : what both presses share: force (N) or depth (mm)
    """

    rig: str = "rigs/gelsight_mini"
    settings: Mapping[str, Any] = field(default_factory=dict)
    match: Match = "force"


def case_for(experiment: Experiment, method: Method, plan: PhotometricPlan) -> Experiment:
    """Return the experiment as `method` measures it.

    An experiment that brings lamps of its own is a photometric rig already and stays as it is.

    Raises
    ------
    InputError
        The rig cannot be used, or the experiment's own press fails.
    """
    if TRAITS[method].fringes or experiment.lamps:
        return vary(experiment, {"modality": method})
    return _carried_over(experiment, _rig(plan), plan.match)


def _rig(plan: PhotometricPlan) -> Experiment:
    stand_in = {"name": "rig", "specimen": {"kind": "flat"}}
    try:
        rig = load_experiment(plan.rig, stand_in | dict(plan.settings))
    except InputError as error:
        raise InputError(f"photometric rig: {error}") from None
    if rig.method.fringes:
        raise InputError(
            f"{plan.rig}: modality: found '{rig.modality}', allowed 'photometric_stereo' for the "
            "photometric rig"
        )
    return rig


def _carried_over(experiment: Experiment, rig: Experiment, match: Match) -> Experiment:
    press, origin = _load(experiment, rig, match)
    tree = rig.model_dump(mode="python", exclude={"provenance"})
    tree |= experiment.model_dump(mode="python", include=set(_CARRIED))
    tree["press"] = press.model_dump(mode="python")
    theirs = {
        path: one
        for path, one in rig.provenance.items()
        if path.partition(".")[0] not in _CARRIED and path.removeprefix("press.") not in _LOAD
    }
    ours = {
        path: one
        for path, one in experiment.provenance.items()
        if path.partition(".")[0] in _CARRIED
    }
    kept = {path: one.model_dump() for path, one in (theirs | ours | origin).items()}
    return validate_experiment(tree | {"provenance": kept}, where=experiment.name)


def _load(
    experiment: Experiment, rig: Experiment, match: Match
) -> tuple[Press, dict[str, Provenance]]:
    """Return the press of the rig under the experiment's load, and where the load comes from."""
    pitches = rig.press.model_dump(include={"solver_pitch_mm", "relief_pitch_mm"})
    own = experiment.press
    if match == own.control:
        press = Press(control=match, depth_mm=own.depth_mm, force_n=own.force_n, **pitches)
        name = "press.force_n" if match == "force" else "press.depth_mm"
        found = experiment.provenance.get(name)
        return press, {name: found} if found else {}
    pressed = press_specimen(experiment)
    why = f"computed: the press of the same specimen into {_gel(experiment)}"
    if match == "force":
        force_n = float(f"{pressed.force_n:.{_FORCE_DIGITS}g}")
        press = Press(control="force", force_n=force_n, **pitches)
        return press, {"press.force_n": Provenance(source=f"{why}, {own.depth_mm:g} mm deep")}
    depth_mm = float(f"{pressed.depth_mm:.{_FORCE_DIGITS}g}")
    press = Press(control="depth", depth_mm=depth_mm, **pitches)
    return press, {"press.depth_mm": Provenance(source=f"{why} with {own.force_n:g} N")}


def _gel(experiment: Experiment) -> str:
    slab = experiment.elastomer
    return f"the experiment's own elastomer ({slab.thickness_mm:g} mm, {slab.layout})"

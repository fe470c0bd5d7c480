"""Measure one object by several methods in one sample: all press it in the same way.

The experiments of the methods differ in `modality`; that of a method without a press has no layers.
So the press is computed once. With several methods the names of arrays, figures and the calibration
begin with the method, as in `contact_fpp_depth_mm`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from reconstruction.errors import InputError
from twin.config import Experiment, vary
from twin.config.dataset import SampleContent
from twin.config.loading import by_method
from twin.config.methods import Method
from twin.dataset.quantities import check_held, check_known, held_by
from twin.results.figures import Metric, Metrics
from twin.study.cases import Case


@dataclass(frozen=True)
class MethodPart:
    """The part of a sample that one method gives.

    Attributes
    ----------
    experiment : the experiment of the method
    held : quantities of the sample that the method has
    prefix : beginning of the names of its arrays and figures; empty for a single method
    """

    experiment: Experiment
    held: tuple[str, ...]
    prefix: str = ""


def together(figures: Sequence[tuple[MethodPart, Metrics]]) -> Metrics:
    """Return the figures of all parts of a sample by name, and all warnings together."""
    if not figures[0][0].prefix:
        return figures[0][1]
    named: dict[str, Metric] = {}
    warnings: list[str] = []
    for part, known in figures:
        for name, value in known.items():
            if name == "warnings" and isinstance(value, list):
                warnings += [f"{part.experiment.modality}: {warning}" for warning in value]
            else:
                named[f"{part.prefix}{name}"] = value
    return named | {"warnings": warnings}


def parts_of(content: SampleContent, experiment: Experiment) -> tuple[MethodPart, ...]:
    """Return the parts of a sample in the order of the recipe's methods.

    Raises
    ------
    ConfigError : the experiment cannot be measured by one of the methods
    """
    if not content.methods:
        return (MethodPart(experiment, content.hold),)
    experiments = [_measured_by(method, experiment) for method in content.methods]
    return tuple(
        MethodPart(each, held_by(content.hold, each), f"{each.modality}_") for each in experiments
    )


def cases_by_method(cases: Sequence[Case], content: SampleContent) -> list[list[Case]]:
    """Return a list of all samples for each method of a sample, with the method's experiments."""
    parts = [parts_of(content, case.experiment) for case in cases]
    return [
        [replace(case, experiment=part.experiment) for case, part in zip(cases, each, strict=True)]
        for each in zip(*parts, strict=True)
    ]


def _measured_by(method: Method, experiment: Experiment) -> Experiment:
    return experiment if experiment.modality == method else vary(experiment, by_method(method))


def check_content(content: SampleContent, experiment: Experiment) -> None:
    """Check that an experiment has all quantities of a sample, each by one of its methods.

    Raises
    ------
    InputError : a name is not known, or no method of the sample has such a quantity
    ConfigError : the experiment cannot be measured by one of the methods
    """
    parts = parts_of(content, experiment)
    if not content.methods:
        check_held(content.hold, experiment)
        return
    check_known(content.hold)
    for name in content.hold:
        if not any(name in part.held for part in parts):
            raise InputError(
                f"sample.hold: {name}: found in none of the methods {', '.join(content.methods)} "
                f"of {experiment.name}; remove the name, or change sample.methods"
            )
    for part in parts:
        if not part.held:
            raise InputError(
                f"sample.hold: found no quantity of the method {part.experiment.modality}; add "
                "one, or remove the method from sample.methods"
            )

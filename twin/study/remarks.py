"""Warnings in the results of a study: each kind is listed once, with its cases and a remedy.

Warnings that differ only in numbers are of one kind. The remark on a kind has the text of its
first case.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from reconstruction.errors import counted
from twin.config.quantities import outside_sources
from twin.mechanics.models import model_of
from twin.mechanics.validity import remedy_of
from twin.results.figures import why_absent
from twin.study.cases import Case
from twin.study.measuring import TRUE_RIG

_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")
_NO_POINT = (
    "no valid point: see pixels without a point in the report of one case; more light (exposure_ms,"
    " a brighter coating), or camera and projector that see the same place"
)
_NOTHING_TO_SCORE = (
    "no pixel that ought to give a point: move specimen or camera until the specimen is in view"
)
# Remedies that increase the contact area; the key is True for press models in which a sheet wraps
# the object.
_TOUCHES = {
    True: "raise press.back_pressure_kpa, or the travel, press.depth_mm",
    False: "raise press.force_n or press.depth_mm",
}


@dataclass(frozen=True)
class Remark:
    """One kind of warning and the cases that have it.

    Attributes
    ----------
    text : the warning as in the first case, with a remedy
    digests : digests of the cases that have the warning
    differs : whether the numbers of other cases are different
    """

    text: str
    digests: tuple[str, ...]
    differs: bool = False

    def in_words(self, of: int) -> str:
        """Return a text: number of cases with the warning, out of `of` cases, and the warning."""
        of_first = " (numbers of the first of them)" if self.differs else ""
        return f"{len(self.digests)} of {counted(of, 'case')}: {self.text}{of_first}"


def remarks_of(
    figures: Mapping[str, Mapping[str, Any]], of: Iterable[Case] = ()
) -> tuple[Remark, ...]:
    """Return the kinds of warnings of finished cases, the most frequent first.

    Parameters
    ----------
    figures : by digest of the case, the figures of its `result.json`
    of : the cases; their values may be outside the ranges of their sources
    """
    outside = {c.digest: outside_sources(c.experiment) for c in of if c.digest in figures}
    texts: dict[str, dict[str, None]] = {}
    cases: dict[str, list[str]] = {}
    for digest, of_case in figures.items():
        for text in dict.fromkeys((*_warned(of_case), *outside.get(digest, ()))):
            kind = _NUMBER.sub("#", text)
            texts.setdefault(kind, {})[text] = None
            if digest not in cases.setdefault(kind, []):
                cases[kind].append(digest)
    ranked = sorted(cases.items(), key=lambda item: -len(item[1]))
    return tuple(
        Remark(_with_remedy(next(iter(texts[kind]))), tuple(some), len(texts[kind]) > 1)
        for kind, some in ranked
    )


def _with_remedy(text: str) -> str:
    remedy = remedy_of(text)
    return f"{text}; {remedy}" if remedy else text


def _warned(figures: Mapping[str, Any]) -> Iterator[str]:
    nothing = _nothing_measured(figures)
    if nothing:
        yield nothing
    for name in ("warnings", "unfitted_balls"):
        warnings = figures.get(name)
        if isinstance(warnings, (list, tuple)):
            yield from warnings
    for name, why in figures.items():
        if name.endswith("_why") and why and not nothing and not name.startswith(TRUE_RIG):
            yield f"{name.removesuffix('_why')} has no value: {why}"


def _nothing_measured(figures: Mapping[str, Any]) -> str:
    absent = why_absent(figures)
    if absent:
        return _NO_POINT if absent == "no valid point" else _NOTHING_TO_SCORE
    if figures.get("object_points") != 0:
        return ""
    model = figures.get("mechanics_model")
    if model is None:
        return "no point of the object: move specimen or camera until the specimen is in view"
    remedy = _TOUCHES[model_of(str(model)).wraps]
    return f"no point of the object (no contact in view of the camera): {remedy}"

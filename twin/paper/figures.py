"""All figures of the reproduction: title, caption, cases and drawing function of each figure."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.paper.hardness import draw_hardness
from twin.paper.identified import draw_ridges
from twin.paper.object_figures import (
    COMPARED_OBJECTS,
    HARD_OBJECTS,
    RODS,
    draw_direct_and_contact,
    draw_grid,
    draw_missing,
    draw_rods,
    draw_sphere_fit,
)
from twin.paper.plan import BALLS, experiment_of, pressed_face
from twin.paper.rig_figures import draw_concept, draw_setup

_FPP, _ALL = ("direct_fpp", "contact_fpp"), ("photometric_stereo", "contact_fpp")


@dataclass(frozen=True)
class PaperFigure:
    """Description of one figure of the reproduction.

    Attributes
    ----------
    title, caption : texts of the figure on the page
    paper : name of the corresponding figure of the paper; empty if there is none
    cases : (experiment's name, method) of every case that the figure shows
    draw : function (cases, stem) that draws from the folder `cases` and writes `stem`.png and
        `stem`.pdf
    """

    title: str
    caption: str
    paper: str
    cases: tuple[tuple[str, str], ...]
    draw: Callable[[Path, Path], None]


@lru_cache
def _pressed() -> tuple[Experiment, PressedElastomer]:
    # On coarse cells, as in the table on the fit region: sufficient for a sketch.
    experiment = experiment_of(BALLS)
    return experiment, pressed_face(experiment)


def _cases(names: dict[str, str], methods: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    return tuple((name, method) for name in names for method in methods)


FIGURES: dict[str, PaperFigure] = {
    "concept": PaperFigure(
        "Principle",
        "(a) Section through the two balls: sheet, relief and specimen to scale, devices at a "
        "reduced distance. The specimen presses the clear face, the coat on the far face follows, "
        "and fringes are projected onto the coat. (b) The same sheet cut open, rendered; the "
        "silicone is painted blue.",
        "Fig. 1, concept",
        (),
        lambda _, stem: draw_concept(stem, *_pressed()),
    ),
    "ridges": PaperFigure(
        "Correlated fields of the identification",
        "Joint posterior samples of the pairs of unknown fields with the largest correlation, over "
        "the prior's range; the cross marks the values used here.",
        "",
        (),
        draw_ridges,
    ),
    "hardness": PaperFigure(
        "Hardness against mixing ratio",
        "Shore A of the three silicones with the plausible range; the paper's graph has no "
        "numbers, its text states 20 for 1:1. Young's modulus by Gent's relation; error bars: all "
        "valid formulas and ±5 points of hardness. Below Shore A 20 the formulas extrapolate.",
        "Fig. 2, Shore graph",
        (),
        draw_hardness,
    ),
    "setup": PaperFigure(
        "Set-up",
        "(a) Camera and projector at the poses of the experiment; the pyramids are their fields of "
        "view on the undeformed coat. Housings, frame and stage are schematic. (b) The pressed "
        "sheet with fringes.",
        "Fig. 3, photograph of the set-up",
        (),
        lambda _, stem: draw_setup(stem, *_pressed()),
    ),
    "direct_and_contact": PaperFigure(
        "Metal and clear objects",
        "Fringe image and measured surface of each object, without the sheet (top) and under it "
        "(bottom). Holes are pixels without a measurement; points far outside the true heights are "
        "omitted. Percentages: share of the surface's pixels with a point, and with an error "
        "within the stated limit. Each surface has its own height scale: the bare objects are "
        "higher than the relief of the coat.",
        "Fig. 5",
        _cases(HARD_OBJECTS, _FPP),
        draw_direct_and_contact,
    ),
    "missing": PaperFigure(
        "Pixels without a measurement, and errors",
        "Top: reasons why pixels on the bare object have no point. Middle and bottom: measured "
        "minus true height of both methods on one scale; gray: no measurement, or not scored.",
        "",
        _cases(HARD_OBJECTS, _FPP),
        draw_missing,
    ),
    "rods": PaperFigure(
        "Acrylic rods",
        "Rod, fringe image and measured surface, and the mean cross-section of 2 mm of the rod "
        "with its width where it crosses 50 % of the height between crest and valleys.",
        "Fig. 7",
        _cases(RODS, ("contact_fpp",)),
        draw_rods,
    ),
    "grid": PaperFigure(
        "Comparison with GelSight",
        "Object, image of a GelSight Mini, fringe image, and both measured surfaces; the two "
        "surfaces of an object share size, enlargement and height scale.",
        "Fig. 8",
        _cases(COMPARED_OBJECTS, _ALL),
        draw_grid,
    ),
    "sphere_fit": PaperFigure(
        "Sphere fits",
        "Two joined 8 mm balls: measured surfaces on one height scale, radial residuals of the "
        "least-squares spheres, and their histograms, on one scale for both methods; residuals "
        "beyond the scale are counted in the outermost bins.",
        "Fig. 9",
        (("two_balls", "photometric_stereo"), ("two_balls", "contact_fpp")),
        draw_sphere_fit,
    ),
}
"""Figures of the reproduction by name, in the order of the paper."""


def draw_figure(name: str, cases: Path, out: Path) -> None:
    """Draw one figure into `out` as `name`.png and `name`.pdf.

    Parameters
    ----------
    name : a key of FIGURES
    cases : folder of cases, `NAME/METHOD/` with panels; a panel of a missing case has the text "not
        measured"

    Raises
    ------
    InputError
        Unknown name, panels damaged, or `out` cannot be written.
    MissingBackend
        No usable Dr.Jit backend.
    """
    if name not in FIGURES:
        raise InputError(f"figure: found '{name}', allowed: {', '.join(FIGURES)}")
    FIGURES[name].draw(cases, out / name)

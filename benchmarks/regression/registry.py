"""All cases and figures of the regression benchmarks."""

from benchmarks.regression.accuracy_registry import FRINGES, OTHERS
from benchmarks.regression.cases import figures_of
from benchmarks.regression.speed_registry import SPEEDS

CASES = (*FRINGES, *OTHERS, *SPEEDS)
FIGURES = figures_of(CASES)
ACCURACY_FIGURES = sum(figure.kind == "accuracy" for figure in FIGURES.values())

"""A case measures one or several figures together; its name is what `--only` takes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from benchmarks.regression.figures import GuardedFigure, Values


@dataclass(frozen=True)
class BenchmarkCase:
    """Figures that are measured together.

    Attributes
    ----------
    name, figures
    how : image size and repetitions
    measure : returns values of every figure
    quick : runs with `--quick` too
    """

    name: str
    how: str
    figures: tuple[GuardedFigure, ...]
    measure: Callable[[], Values]
    quick: bool = True


def figures_of(cases: Iterable[BenchmarkCase]) -> dict[str, GuardedFigure]:
    """Return all figures by name, in order."""
    return {figure.name: figure for case in cases for figure in case.figures}


def repeated(count: int, once: Callable[[int], dict[str, float]]) -> Values:
    """Measure with seeds 1 to `count`, telling each, and collect the values by name."""
    values: Values = {}
    for seed in range(1, count + 1):
        print(f"  seed {seed} of {count}", flush=True)
        for name, value in once(seed).items():
            values.setdefault(name, []).append(value)
    return values

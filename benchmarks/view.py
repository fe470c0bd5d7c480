"""Processor time in which a slider of `twin view` updates a thin sheet, and then its figures.

    ./run bench view
    ./run bench view --experiment examples/wrapped_nut

Each slider is moved by 1 and by 20 % of its value (of its range if the value is 0), from the
experiment's values. The update is the press on coarse cells, the camera image, and the coat and
section of the scene; the figures follow when the sliders rest. An update that is not possible has
no time. The last line has the largest times of the updates, and that of the figures.
"""

import argparse
import resource
from collections.abc import Iterable

from benchmarks._harness import print_figures, processor_s
from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.viewer.preview import Preview
from twin.viewer.scene import coat_surface, section_of
from twin.viewer.sliders import SliderRange, slider_ranges

MECHANICAL = ("elastomer", "press")
SHARES = (0.01, 0.2)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--experiment", default="examples/wrapped_balls", help="a thin sheet")
    experiment = load_experiment(parser.parse_args().experiment)
    preview = Preview(experiment)
    first_s = _spent(preview, {})
    _spent(preview, {"coating.base_albedo": 0.3})  # compiles
    sliders = [s for s in slider_ranges(experiment) if s.group in MECHANICAL]
    updates = [(s, share, _update_s(preview, s, share)) for share in SHARES for s in sliders]
    for slider, share, seconds in updates:
        if seconds is not None:
            print(f"{slider.key} {100 * share:+.0f} %: {seconds:.2f} s")
    start = processor_s(resource.RUSAGE_SELF)
    preview.measure({})
    figures_s = processor_s(resource.RUSAGE_SELF) - start
    small, large = (largest(s for _, at, s in updates if at == share) for share in SHARES)
    print_figures({"first_s": first_s, "step_s": small, "jump_s": large, "figures_s": figures_s}, 2)


def largest(times: Iterable[float | None]) -> float | None:
    """Return the largest time, without those of updates that are not possible."""
    return max((time for time in times if time is not None), default=None)


def moved(slider: SliderRange, share: float) -> float:
    """Return the value moved by a share, of the range if it is 0; downwards from the upper end."""
    step = share * (abs(slider.value) or slider.high - slider.low)
    upwards = slider.value + step <= slider.high
    return slider.value + step if upwards else max(slider.value - step, slider.low)


def _update_s(preview: Preview, slider: SliderRange, share: float) -> float | None:
    _spent(preview, {})
    return _spent(preview, {slider.key: moved(slider, share)})


def _spent(preview: Preview, changes: dict[str, float]) -> float | None:
    """Return the processor time of an update, s; None if it is not possible."""
    start = processor_s(resource.RUSAGE_SELF)
    try:
        shown = preview.show(changes)
        coat_surface(shown.pressed)
        section_of(shown.experiment, shown.pressed)
    except InputError as error:
        print(f"{changes}: {error}")
        return None
    return processor_s(resource.RUSAGE_SELF) - start


if __name__ == "__main__":
    main()

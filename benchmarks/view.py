"""Processor time in which a slider of `twin view` updates a thin sheet, and then its figures.

    ./run bench view
    ./run bench view --experiment examples/wrapped_nut

Each slider is moved by 1 and by 20 % of its value, from the experiment's values. The update is the
press on coarse cells, the camera image, and the coat and section of the scene; the figures follow
when the sliders rest. The last line has the largest times of the updates, and that of the figures.
"""

import argparse
import resource

import _harness

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
        print(f"{slider.key} {100 * share:+.0f} %: {seconds:.2f} s")
    start = _harness.processor_s(resource.RUSAGE_SELF)
    preview.measure({})
    figures_s = _harness.processor_s(resource.RUSAGE_SELF) - start
    small, large = (max(s for _, at, s in updates if at == share) for share in SHARES)
    _harness.print_figures(
        {"first_s": first_s, "step_s": small, "jump_s": large, "figures_s": figures_s}, 2
    )


def _update_s(preview: Preview, slider: SliderRange, share: float) -> float:
    _spent(preview, {})
    return _spent(preview, {slider.key: min(slider.value * (1 + share), slider.high)})


def _spent(preview: Preview, changes: dict[str, float]) -> float:
    start = _harness.processor_s(resource.RUSAGE_SELF)
    try:
        shown = preview.show(changes)
        coat_surface(shown.pressed)
        section_of(shown.experiment, shown.pressed)
    except InputError as error:
        print(f"{changes}: {error}")
    return _harness.processor_s(resource.RUSAGE_SELF) - start


if __name__ == "__main__":
    main()

"""Speed of the one-trace renderer: a whole fringe stack against stock Mitsuba, frame by frame.

Both render the same pressed face, camera, coating and samples per pixel. A stock frame is
`mi.render` with the `direct` integrator and the `projector` emitter, scene and texture loaded
before; a stack is timed until each frame is an array in memory. Two comparisons in one run:

- a whole stack against ONE stock frame, full film: median of alternating turns after a warm-up of
  each, so no kernel is compiled in them. The stack once with a shadow ray from every point, as
  stock traces them, and once as the twin does: without, as this relief provably casts no shadow.
  Stock traces rays through its tree, the stack over the heights (`twin.optics.heights`);
- a whole stack against ALL its frames by stock renders, small film; the writing of the pattern
  textures is not included.

The memory is the peak of this process up to the end of the first stacks, before stock Mitsuba is
loaded: press, mesh, BVH and all frames.

Last line: {"stack_with_shadow_rays_over_one_frame": ratio,
"stack_without_shadow_rays_over_one_frame": ratio, "naive_over_stack": ratio, "frames": n, ...}.
"""

import statistics
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from benchmarks._harness import in_turns, print_figures, quick_parser, resident_bytes, seconds
from twin.config import Experiment, load_experiment
from twin.mechanics import face_mesh, press_with
from twin.optics.session import activate

TURNS = 7
TIMED = "stack with shadow rays", "stack without", "one stock frame"
SMALL_FILM_BINNING = 4
SETTINGS = {"patterns.period_px": 10}
"""Finer fringes than the paper's 18 px: one Gray bit more along the columns, 54 frames."""


def main() -> None:
    """Time both engines and print one JSON line."""
    parser = quick_parser(__doc__, "968 x 732 instead of 1936 x 1464")
    backend = activate()
    case = StackCase.of_film(2 if parser.parse_args().quick else 1)
    print(f"{backend.variant}: {case.frames} frames at {case.size}, {case.samples} samples")
    if case.rig.shadows:
        raise SystemExit("bench stack: this relief needs shadow rays, so no stack omits them")
    case.trace()
    case.trace()
    memory_gib = resident_bytes("VmHWM") / 2**30
    print(f"peak memory of press and stack {memory_gib:.2f} GiB")
    figures = against_one_frame(case) | against_all_frames() | {"peak_memory_gib": memory_gib}
    facts = {"frames": case.frames, "size": case.size, "samples": case.samples}
    print_figures(figures | facts | {"triangles": len(case.face.faces)})


@dataclass(frozen=True)
class StackCase:
    """The paper's sensor with two balls pressed in, ready to be traced."""

    experiment: Experiment
    face: Any
    scene: Any
    rig: Any
    patterns: Any
    tables: Any

    @classmethod
    def of_film(cls, binning: int) -> "StackCase":
        """Press, mesh and load."""
        from tests.optics.scenes import coated_scene
        from twin.optics.light import light_tables, pattern_set
        from twin.optics.scene import coated_rig

        experiment = load_experiment("examples/slab_balls", SETTINGS | {"camera.binning": binning})
        pressed = press_with(
            experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
        )
        face = face_mesh(pressed)
        patterns = pattern_set(experiment.projector, experiment.patterns)
        scene, rig = coated_scene(experiment, face), coated_rig(experiment, face)
        tables = light_tables(experiment.projector, patterns)
        return cls(experiment, face, scene, rig, patterns, tables)

    def with_shadow_rays(self) -> "StackCase":
        """Return the same case traced with shadow rays, needed or not."""
        return replace(self, rig=replace(self.rig, shadows=True))

    @property
    def frames(self) -> int:
        """Number of frames of the sequence."""
        return len(self.patterns.frames)

    @property
    def samples(self) -> int:
        """Camera rays per pixel."""
        return self.experiment.render.samples

    @property
    def size(self) -> str:
        """Size of the film, px."""
        return f"{self.rig.camera.pinhole.width_px}x{self.rig.camera.pinhole.height_px}"

    def trace(self) -> Any:
        """Trace the whole stack."""
        from twin.optics.one_trace import trace_stack

        return trace_stack(self.scene, self.rig, self.tables, self.samples)

    def texture(self, index: int) -> Any:
        """Light of one frame on a stock emitter's canvas, and the canvas."""
        from twin.optics import stock

        canvas = stock.canvas_for(self.rig, "projector", texels_per_px=2)
        frame = self.patterns.frames[index]
        return stock.frame_texture(frame, index, self.rig, self.tables, canvas), canvas

    def stock_scene(self) -> Any:
        """Load the same scene for stock Mitsuba, with the first frame."""
        from twin.optics import stock
        from twin.optics.materials import coated_mesh
        from twin.optics.rig import perspective_sensor

        camera, (texture, canvas) = self.rig.camera, self.texture(0)
        return stock.frame_scene(
            coated_mesh(self.face, self.experiment.coating.bsdf()),
            stock.emitter_dict(texture, self.rig, canvas),
            perspective_sensor(camera.pinhole, camera.T_world_from_device, self.samples),
        )


def against_one_frame(case: StackCase) -> dict[str, float]:
    """Seconds of a stack, with shadow rays and without, and of one stock frame, and the ratios."""
    from twin.optics import stock

    scene, shadowed, number = case.stock_scene(), case.with_shadow_rays(), count()
    calls = shadowed.trace, case.trace, lambda: stock.render_frame(scene, next(number))
    calls[2]()
    calls[0]()
    turns = in_turns(dict(zip(TIMED, calls, strict=True)), TURNS)
    for turn in turns:
        print(", ".join(f"{name} {s:.2f} s" for name, s in turn.items()))
    with_rays, without, frame = (np.array([turn[name] for turn in turns]) for name in TIMED)
    return {
        "stack_with_shadow_rays_over_one_frame": float(np.median(with_rays / frame)),
        "stack_without_shadow_rays_over_one_frame": float(np.median(without / frame)),
        "stack_with_shadow_rays_s": float(np.median(with_rays)),
        "stack_s": float(np.median(without)),
        "stock_frame_s": float(np.median(frame)),
        "frames_per_s": case.frames / float(np.median(without)),
    }


def against_all_frames() -> dict[str, float]:
    """Render every frame by itself on a small film, and the stack there."""
    import mitsuba as mi

    from twin.optics import stock

    case = StackCase.of_film(SMALL_FILM_BINNING)
    scene = case.stock_scene()
    case.trace()
    stock.render_frame(scene, 0)
    pattern, naive_s, stack_s = mi.traverse(scene), 0.0, []
    for index in range(case.frames):
        pattern["emitter.irradiance.data"] = case.texture(index)[0][..., None]
        pattern.update()
        naive_s += seconds(lambda n=index: stock.render_frame(scene, n))
        if index % 6 == 0:
            stack_s.append(seconds(case.trace))
    median_s = statistics.median(stack_s)
    print(f"{case.size}: {case.frames} stock frames {naive_s:.2f} s, stack {median_s:.3f} s")
    return {"naive_over_stack": naive_s / median_s}


if __name__ == "__main__":
    main()

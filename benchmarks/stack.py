"""Speed of the one-trace renderer: a whole fringe stack against ONE stock Mitsuba frame.

Both see the same pressed face, camera, coating and samples per pixel. The stock frame is
`mi.render` with the `direct` integrator and the `projector` emitter, scene and texture loaded
beforehand; the stack is timed until all frames lie in memory as one array. Median of alternating
pairs after one warm-up of each, so kernel compilation is in neither.

Last line: {"stack_over_one_frame": ratio, "frames": n, ...}.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

from twin.config import load_experiment
from twin.mechanics import face_mesh
from twin.modalities import press_specimen
from twin.optics.backend import activate

PAIRS = 5


def main() -> None:
    """Time both engines in alternation and print one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="968 x 732 instead of 1936 x 1464")
    binning = 2 if parser.parse_args().quick else 1
    backend = activate()
    stack, frame, facts = prepare(binning)
    print(f"{backend.variant}: {facts['frames']} frames at {facts['size']}, 4 samples per pixel")
    print(f"first calls: stack {seconds(stack):.2f} s, stock frame {seconds(frame):.2f} s")
    pairs = []
    for number in range(PAIRS):
        pairs.append((seconds(stack), seconds(frame)))
        print(f"pair {number + 1}: stack {pairs[-1][0]:.2f} s, stock frame {pairs[-1][1]:.2f} s")
    stack_s, frame_s = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(a / b for a, b in pairs)
    figures = {"stack_over_one_frame": round(ratio, 3), "stack_s": round(stack_s, 3)}
    print(json.dumps(figures | {"stock_frame_s": round(frame_s, 3)} | facts))


def prepare(binning: int) -> tuple[Callable[[], Any], Callable[[], Any], dict[str, Any]]:
    """Load everything; return the two calls to time and the facts of the case."""
    from twin.optics import one_trace, stock
    from twin.optics.coat import coated_mesh, coating_bsdf
    from twin.optics.device_frames import perspective_sensor
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.scene import coated_scene, rig_of

    experiment = load_experiment("paper/two_balls", {"camera.binning": binning})
    face = face_mesh(press_specimen(experiment))
    scene, rig = coated_scene(experiment, face), rig_of(experiment)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    samples = experiment.render.samples
    canvas = stock.canvas_for(rig, "projector", texels_per_px=2)
    texture = stock.frame_texture(patterns.frames[0], 0, rig, tables, canvas)
    camera = rig.camera
    stock_scene = stock.frame_scene(
        coated_mesh(face, coating_bsdf(experiment.coating)),
        stock.emitter_dict(texture, rig, canvas),
        perspective_sensor(camera.pinhole, camera.T_world_from_device, samples),
    )
    facts = {
        "frames": len(patterns.frames),
        "size": f"{camera.pinhole.width_px}x{camera.pinhole.height_px}",
        "samples": samples,
        "triangles": len(face.faces),
    }
    seeds = iter(range(1, 100))
    return (
        lambda: one_trace.trace_stack(scene, rig, tables, samples),
        lambda: stock.render_frame(stock_scene, next(seeds)),
        facts,
    )


def seconds(call: Callable[[], Any]) -> float:
    """Wall-clock seconds of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()

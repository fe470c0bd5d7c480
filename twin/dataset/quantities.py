"""Quantities that a sample of a data set may contain, each with its axes, unit and frame.

Images are over camera pixels, (row, col). No value is NaN: a quantity is 0 where it does not exist,
and `label`, `lit` or `decoded_reason` state where that is. Phases are those of the measuring period
along a projector axis: phase = 2 pi coordinate / period, with the coordinate 0 at the middle of the
first pixel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from reconstruction.errors import InputError
from reconstruction.patterns import Axis
from twin.config import Experiment
from twin.config.methods import METHODS
from twin.dataset import pixel_values
from twin.dataset.pixel_values import Array
from twin.dataset.taken import TakenSample
from twin.mechanics.choice import may_wrap
from twin.optics.light import pattern_set

Need = Literal["fringes", "column", "row", "uniform", "press", "sheet", "colours", "decoded"]


@dataclass(frozen=True)
class SampleQuantity:
    """Description of one quantity of a sample.

    Attributes
    ----------
    axes : names of the axes of the array
    unit : unit of the values; 1 for numbers without unit
    meaning : one sentence for the data card
    values : function that returns the array of a sample
    needs : traits of the experiment that the quantity needs
    """

    axes: tuple[str, ...]
    unit: str
    meaning: str
    values: Callable[[TakenSample], Array]
    needs: tuple[Need, ...] = ()


PIXELS, VECTORS, COLOURS = ("row", "col"), ("row", "col", "xyz"), ("row", "col", "rgb")


def _along(axis: Axis) -> Mapping[str, SampleQuantity]:
    """Return the quantities along one projector axis, by name."""
    needs: tuple[Need, ...] = ("fringes", axis)
    at = partial(partial, axis=axis)
    return {
        f"projector_{axis}_px": SampleQuantity(
            PIXELS,
            "px",
            f"true projector {axis} of the surface point; whole at pixel centres",
            at(pixel_values.coordinate_px),
            ("fringes",),
        ),
        f"phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"true absolute phase along {axis}s; 0 where not lit",
            at(pixel_values.phase_32),
            needs,
        ),
        f"wrapped_phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"true phase along {axis}s in [0, 2 pi)",
            at(pixel_values.wrapped_phase),
            needs,
        ),
        f"order_{axis}": SampleQuantity(
            PIXELS, "1", f"true fringe order along {axis}s", at(pixel_values.order), needs
        ),
        f"decoded_phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"decoded absolute phase along {axis}s; 0 where masked",
            at(pixel_values.decoded_phase),
            (*needs, "decoded"),
        ),
        f"decoded_wrapped_phase_{axis}_rad": SampleQuantity(
            PIXELS,
            "rad",
            f"decoded phase along {axis}s of the single pixel, in [0, 2 pi)",
            at(pixel_values.decoded_wrapped_phase),
            (*needs, "decoded"),
        ),
        f"decoded_modulation_{axis}_dn": SampleQuantity(
            PIXELS,
            "DN",
            f"amplitude of the fringes along {axis}s",
            at(pixel_values.decoded_modulation),
            (*needs, "decoded"),
        ),
    }


SAMPLE_QUANTITIES: Mapping[str, SampleQuantity] = {
    "frames": SampleQuantity(
        ("frame", "row", "col"),
        "DN",
        "recorded frames; uint8 up to 8 bits of the camera, else uint16",
        pixel_values.frames,
        ("fringes",),
    ),
    "radiance": SampleQuantity(
        ("frame", "row", "col"),
        "mW / (mm^2 sr)",
        "noise-free frames: mean radiance of each pixel",
        lambda taken: np.stack(taken.fringes.radiance.frames),
        ("fringes",),
    ),
    "white": SampleQuantity(
        PIXELS,
        "mW / (mm^2 sr)",
        "noise-free radiance under the white frame",
        pixel_values.white,
        ("fringes", "uniform"),
    ),
    "albedo": SampleQuantity(
        PIXELS,
        "1",
        "reflectance of the surface at normal incidence, diffuse and specular; 0 no surface",
        pixel_values.albedo,
    ),
    "image": SampleQuantity(
        COLOURS,
        "level",
        "image of the pressed gel",
        lambda taken: taken.image.picture,
        ("colours",),
    ),
    "background": SampleQuantity(
        COLOURS,
        "level",
        "mean image of the undeformed gel",
        lambda taken: taken.image.calibration.background,
        ("colours",),
    ),
    "depth_mm": SampleQuantity(
        PIXELS,
        "mm",
        "true distance from the camera along its optical axis",
        lambda taken: taken.truth.depth_mm,
    ),
    "normal_world": SampleQuantity(
        VECTORS, "1", "true unit normal, world frame", lambda taken: taken.truth.normals_world
    ),
    "point_world_mm": SampleQuantity(
        VECTORS,
        "mm",
        "true surface point, world frame",
        lambda taken: taken.truth.points_world_mm,
    ),
    "label": SampleQuantity(
        PIXELS,
        "1",
        "0 no surface, 1 stage, 2 measured surface (coat or specimen)",
        pixel_values.label,
    ),
    "lit": SampleQuantity(
        PIXELS,
        "1",
        "1 where the point is lit by the projector, or in the evaluated field (photometric)",
        lambda taken: taken.truth.lit.astype(np.uint8),
    ),
    "contact": SampleQuantity(
        PIXELS,
        "1",
        "1 where the elastomer below the point touches the object",
        pixel_values.contact,
        ("press",),
    ),
    "pressure_kpa": SampleQuantity(
        PIXELS, "kPa", "contact pressure below the point", pixel_values.pressure, ("press",)
    ),
    "touched_face_z_mm": SampleQuantity(
        PIXELS,
        "mm",
        "world z of the touched face below the point; in the contact the object's surface",
        pixel_values.touched_face,
        ("press",),
    ),
    "thickness_mm": SampleQuantity(
        PIXELS, "mm", "local thickness of the sheet", pixel_values.thickness, ("press", "sheet")
    ),
    **_along("column"),
    **_along("row"),
    "decoded_depth_mm": SampleQuantity(
        PIXELS, "mm", "decoded depth; 0 where masked", pixel_values.decoded_depth, ("decoded",)
    ),
    "decoded_normal_world": SampleQuantity(
        VECTORS,
        "1",
        "decoded unit normal; 0 where masked",
        pixel_values.decoded_normal,
        ("decoded",),
    ),
    "decoded_sigma_z_mm": SampleQuantity(
        PIXELS,
        "mm",
        "predicted standard deviation of world z; 0 where masked",
        lambda taken: np.asarray(taken.maps.point_map.sigma_z_mm, np.float32),
        ("fringes", "decoded"),
    ),
    "decoded_reason": SampleQuantity(
        PIXELS,
        "1",
        "reason code of a masked pixel; 0: decoded",
        pixel_values.decoded_reason,
        ("decoded",),
    ),
}
"""All quantities by name."""


def needs_decoding(held: tuple[str, ...]) -> bool:
    """Return True if one of the named quantities is computed from decoded frames."""
    return any("decoded" in SAMPLE_QUANTITIES[name].needs for name in held)


def needs_albedo(held: tuple[str, ...]) -> bool:
    """Return True if one of the named quantities is the albedo, which is traced by itself."""
    return "albedo" in held


def quantity_of(name: str) -> SampleQuantity | None:
    """Return the quantity of an array of a sample, which may begin with a method; None if none."""
    method = next((method for method in METHODS if name.startswith(f"{method}_")), None)
    return SAMPLE_QUANTITIES.get(name if method is None else name.removeprefix(f"{method}_"))


def check_known(held: tuple[str, ...]) -> None:
    """Check that all names of a list are quantities; InputError if one is not."""
    for name in held:
        if name not in SAMPLE_QUANTITIES:
            allowed = ", ".join(SAMPLE_QUANTITIES)
            raise InputError(f"sample.hold: found '{name}', allowed: {allowed}")


def check_held(held: tuple[str, ...], experiment: Experiment) -> None:
    """Check that an experiment has all quantities of a list.

    Raises
    ------
    InputError : a name is not known, or the experiment has no such quantity
    """
    check_known(held)
    traits = _traits_of(experiment)
    for name in held:
        missing = [need for need in SAMPLE_QUANTITIES[name].needs if need not in traits]
        if missing:
            raise InputError(
                f"sample.hold: {name}: needs {_NEEDS[missing[0]]}; {experiment.name} has none; "
                "remove the name, or change the scene"
            )


def held_by(names: tuple[str, ...], experiment: Experiment) -> tuple[str, ...]:
    """Return those of the named quantities that an experiment has."""
    traits = _traits_of(experiment)
    known = (name for name in names if name in SAMPLE_QUANTITIES)
    return tuple(name for name in known if traits.issuperset(SAMPLE_QUANTITIES[name].needs))


_NEEDS: Mapping[Need, str] = {
    "fringes": "a method with fringes",
    "column": "phase steps along the axis 'column'",
    "row": "phase steps along the axis 'row'",
    "uniform": "a white frame (patterns.uniform)",
    "press": "a method with a press",
    "sheet": "a thin sheet",
    "colours": "modality = 'photometric_stereo'",
    "decoded": "decoded frames",
}


def _traits_of(experiment: Experiment) -> set[Need]:
    traits: set[Need] = {"decoded"}
    if experiment.method.fringes:
        patterns = pattern_set(experiment.projector, experiment.patterns)
        traits |= {"fringes", *(patterns.axes if patterns.steps else ())}
        traits |= {"uniform"} if patterns.uniform else set()
    else:
        traits.add("colours")
    if experiment.method.presses:
        traits.add("press")
        traits |= {"sheet"} if may_wrap(experiment.elastomer) else set()
    return traits

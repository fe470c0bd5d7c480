"""The programs that are compared, the work that each can do, and what it lacks."""

from dataclasses import dataclass

from benchmarks.contest.environments import Environment

HERE = Environment("twin")


@dataclass(frozen=True)
class Contestant:
    """A program that does some of the work.

    Attributes
    ----------
    name : its module is `with_NAME`
    label : name in the table
    environment : where it is installed
    scope : by name of each piece of work that it does: how, and properties that it lacks
    """

    name: str
    label: str
    environment: Environment
    scope: dict[str, str]


CONTESTANTS = (
    Contestant(
        "twin",
        "fringe-twin",
        HERE,
        {
            "decode": "53 frames, 16 bit; sub-pixel, with filter and sigma per pixel",
            "tactile": "press, light paths and noise; its lamps were fitted to these presses",
            "press": "also force control, free slabs, thin sheets",
            "frame": "all 54 frames by one trace; refraction, noise and sigma in other stages",
        },
    ),
    Contestant(
        "fringes",
        "fringes",
        Environment("fringes", ("fringes==2.1.0", "numpy==2.4.6", "numba==0.68.1")),
        {"decode": "54 frames, 16 bit; sub-pixel; sigma on request; no Gray code, no filter"},
    ),
    Contestant(
        "opencv",
        "OpenCV structured_light",
        Environment("opencv", ("opencv-contrib-python-headless==5.0.0.93",)),
        {"decode": "42 frames, 8 bit; whole pixels, one call per pixel; no sigma"},
    ),
    Contestant(
        "gsoup",
        "gsoup",
        Environment("gsoup", ("gsoup==0.2.9", "mitsuba==3.9.1", "numpy==2.4.6")),
        {
            "decode": "46 frames, 8 bit; whole pixels; no sigma",
            "frame": "one render per frame, three channels; symmetric projector; no refraction,"
            " no noise",
        },
    ),
    Contestant(
        "taxim",
        "taxim (JAX)",
        Environment("taxim", ("taxim[jax-cpu]==1.4.1", "jax==0.10.2")),
        {"tactile": "table of another unit, deformation by filters; no modulus, force or noise"},
    ),
    Contestant(
        "contactmechanics",
        "ContactMechanics",
        Environment("contactmechanics", ("ContactMechanics==1.8.3",)),
        {"press": "periodic layer; no free slab, no sheet, no images"},
    ),
    Contestant(
        "mitsuba",
        "Mitsuba (stock)",
        Environment("mitsuba", ("mitsuba==3.9.1", "numpy==2.4.6")),
        {"frame": "one render per frame; symmetric projector; no noise; black behind a window"},
    ),
)

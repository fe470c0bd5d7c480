"""Reference presses of a photometric sensor: balls, and the undeformed coat, flat or domed."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from reconstruction.photometric import RestSurface
from twin.config import Experiment, seed_sequence
from twin.config.models import Mechanics, Press
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import rest_face_mm
from twin.mechanics.models import PressInput
from twin.optics.backed_coat import seen_face
from twin.optics.rig import world_from_device
from twin.optics.stack import Truth
from twin.pipeline.colour_images import image_pinhole
from twin.pipeline.press import press_smooth, with_texture
from twin.specimens.kinds.ball import Ball

if TYPE_CHECKING:
    import trimesh

    from twin.optics.colour_trace import ColourScene

# Heights of two level planes that determine the lines of sight, mm.
_PLANES_MM = (0.0, 0.5)


def ball_presses(experiment: Experiment) -> list[Experiment]:
    """Return the experiments of the reference presses: balls at random positions of the field.

    Diameters, depths and positions are random numbers from the root seed of the experiment.
    """
    plan, size = experiment.photometric.presses, experiment.photometric
    rng = np.random.default_rng(seed_sequence(experiment, "reference_balls"))
    presses = []
    for _ in range(plan.count):
        diameter_mm = rng.uniform(plan.smallest_diameter_mm, plan.largest_diameter_mm)
        depth_mm = 0.5 * diameter_mm * rng.uniform(plan.shallowest, plan.deepest)
        # The contact's radius is below sqrt(2 R d), that of the ball's section at the depth d.
        half = np.array([size.field_x_mm, size.field_y_mm]) / 2 - np.sqrt(diameter_mm * depth_mm)
        x_mm, y_mm = rng.uniform(-1.0, 1.0, 2) * np.maximum(half, 0.0)
        ball = Ball(diameter_mm=diameter_mm, x_mm=x_mm, y_mm=y_mm)
        presses.append(with_ball(experiment, ball, depth_mm))
    return presses


def with_ball(experiment: Experiment, ball: Ball, depth_mm: float) -> Experiment:
    """Return the experiment with a ball, pressed to a depth, in place of its specimen and press."""
    load = Press(
        control="depth",
        depth_mm=depth_mm,
        solver_pitch_mm=experiment.press.solver_pitch_mm,
        relief_pitch_mm=experiment.press.relief_pitch_mm,
    )
    return experiment.model_copy(update={"specimen": ball, "press": load})


def undeformed(experiment: Experiment) -> PressedElastomer:
    """Return the elastomer without load and texture, on the nodes of a pressed face.

    Raises
    ------
    InputError : the pad cannot be read, or a lamp is not above the undeformed coat
    """
    case = _pressed_lightly(experiment)
    of_model = PressInput(case.mechanics, case.specimen, case.elastomer, case.press)
    # A pad from CAD is pressed in half a minute; a slab, at once, has the same nodes.
    slab = case.model_copy(update={"mechanics": Mechanics()})
    pressed = press_smooth(case if case.mechanics.pad is None else slab)
    rest_mm = rest_face_mm(of_model, pressed.face_x_mm, pressed.face_y_mm)
    coat = replace(
        pressed,
        face_z_mm=np.zeros_like(pressed.face_z_mm) if rest_mm is None else rest_mm,
        pressure_kpa=np.zeros_like(pressed.pressure_kpa),
        contact=np.zeros_like(pressed.contact),
    )
    _check_lamps(experiment, coat)
    return coat


def bare_face(experiment: Experiment, coat: PressedElastomer) -> "trimesh.Trimesh":
    """Return the mesh of the undeformed coat with its texture."""
    case = _pressed_lightly(experiment)
    return seen_face(case, with_texture(case, coat))


def _pressed_lightly(experiment: Experiment) -> Experiment:
    return with_ball(experiment, Ball(diameter_mm=8.0), 0.2)


def _check_lamps(experiment: Experiment, coat: PressedElastomer) -> None:
    """Raise InputError if the undeformed coat rises to the height of a lamp at its border."""
    x_mm, y_mm, z_mm = coat.face_x_mm, coat.face_y_mm, coat.face_z_mm
    for name, lamp in experiment.lamps.items():
        row = int(np.abs(y_mm - lamp.y_mm).argmin())
        col = int(np.abs(x_mm - lamp.x_mm).argmin())
        lowest_mm = lamp.height_mm - lamp.tall_mm / 2
        if lowest_mm <= z_mm[row, col]:
            raise InputError(
                f"lamps.{name}: its lower edge is at {lowest_mm:.4g} mm, allowed above "
                f"{z_mm[row, col]:.4g} mm, the undeformed coat next to it; raise height_mm, or use "
                "a flatter pad"
            )


def rest_surface(
    experiment: Experiment, scene: "ColourScene", coat: PressedElastomer
) -> RestSurface:
    """Return the undeformed coat at the pixels of the final image, with the lines of sight.

    The scene contains the undeformed coat again afterwards.
    """
    level = [
        _traced(experiment, scene, replace(coat, face_z_mm=np.full_like(coat.face_z_mm, z_mm)))
        for z_mm in _PLANES_MM
    ]
    lines = level[1].points_world_mm - level[0].points_world_mm
    sight = lines[..., :2] / np.float32(_PLANES_MM[1] - _PLANES_MM[0])
    rest = _traced(experiment, scene, coat)
    visible = rest.measured & level[0].measured & level[1].measured
    points = np.where(visible[..., None], rest.points_world_mm, level[0].points_world_mm)
    scene.put(bare_face(experiment, coat))
    return RestSurface(
        points.astype(np.float32),
        np.where(visible, _slopes(rest), np.float32(0.0)),
        np.where(visible, np.stack([-sight[..., 1], sight[..., 0]]), np.float32(0.0)),
    )


def _traced(experiment: Experiment, scene: "ColourScene", coat: PressedElastomer) -> Truth:
    pinhole = image_pinhole(experiment)
    scene.put(seen_face(_pressed_lightly(experiment), coat))
    return scene.truth(pinhole, world_from_device(experiment.camera.pose, pinhole))


def _slopes(truth: Truth) -> FloatImage:
    """Return the slopes (2, row, col) of a surface, downwards and to the right."""
    x, y, z = np.moveaxis(truth.normals_world, -1, 0)
    upright = np.where(z > 0.0, z, 1.0)
    return np.asarray(np.stack([y / upright, -x / upright]), np.float32)

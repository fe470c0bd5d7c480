"""Points of the object behind a coat: error over stated uncertainty, free spans, contact pressure.

A tilted cylinder, an ellipsoid and two joined balls under thin sheets are pressed, rendered by a
coarse camera (4 x 4 pixels binned), decoded and compensated with the true sheet, for coats without
texture and with 5 um RMS, each with 10 seeds (`--quick`: 2). Stairs with steps of 0.3 mm are
measured in the same way: next to each step the sheet spans freely, up to 0.2 mm above the tread.

- `compensated_normalised`: RMS over all points and seeds of the distance from the true object over
  its stated standard uncertainty; of the bodies and coats the value that differs most from 1;
- `span_share_wrong`: share of the points on the stairs, and on their plate, with a distance of more
  than 4 standard uncertainties;
- `pressure_over_force`: integral of `pressure_kpa` of press.nc over its cells, over the contact
  force; of all presses the value that differs most from 1.

Last line: {"compensated_normalised", "span_share_wrong", "pressure_over_force"}.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import FloatArray
from reconstruction.evaluate.deviation import normals_of
from reconstruction.evaluate.fit import rms
from reconstruction.triangulation import PointMap
from twin.config import Experiment, load_experiment
from twin.config.sensor_layer import LayerSigma, sensor_layer_of
from twin.mechanics import PressedElastomer
from twin.pipeline import Memory, measure
from twin.pipeline.compensation import compensate_points
from twin.results.compensated import object_points
from twin.specimens import shape_of
from twin.specimens.true_surface import TrueSurface

SEEDS, QUICK_SEEDS = 10, 2
BASE = "examples/wrapped_balls"
CAMERA = {"camera.binning": 4, "mechanics.model": "sheet"}
TEXTURE = {"coating.texture.rms_um": 5.0, "coating.texture.correlation_mm": 0.15}
SHEET = {
    "elastomer.thickness_mm": 0.15,
    "elastomer.length_x_mm": 12.0,
    "elastomer.length_y_mm": 12.0,
    "press.back_pressure_kpa": 2.5,
    "press.depth_mm": 0.6,
}
CYLINDER = {"kind": "rod", "diameter_mm": 6.0, "length_mm": 5.0, "tilt_deg": 6.0}
ELLIPSOID_MM = (3.2, 2.8, 3.0)
STEPS_END_MM, STEP_MM, FOOT_MM, WIDTH_MM = (-3.2, -1.8, -0.4, 3.0), 0.3, 1.0, 2.4
STAIRS: tuple[dict[str, float], ...] = (
    {},
    {"elastomer.thickness_mm": 0.2, "press.back_pressure_kpa": 2.0, "press.depth_mm": 0.3},
)
WRONG_SIGMAS = 4.0
Settings = dict[str, Any]


@dataclass(frozen=True, eq=False)
class MeasuredObject:
    """Distances of the object's points from the truth, mm, and their standard uncertainties."""

    error_mm: FloatArray
    sigma_mm: FloatArray
    pressure_over_force: float

    @property
    def normalised(self) -> FloatArray:
        """Distances over standard uncertainties, (n,)."""
        return self.error_mm / self.sigma_mm


def bodies(folder: Path) -> dict[str, Settings]:
    """Return the settings of the smooth bodies; meshes are written to a folder."""
    ellipsoid = trimesh.creation.icosphere(subdivisions=5)
    ellipsoid.vertices *= ELLIPSOID_MM
    ellipsoid.export(folder / "ellipsoid.stl")
    mesh = {"kind": "mesh", "file": str(folder / "ellipsoid.stl")}
    return {
        "cylinder": {"specimen": CYLINDER, **SHEET},
        "ellipsoid": {"specimen": mesh, **SHEET},
        "balls": {"press.depth_mm": 0.6},
    }


def stairs_mesh() -> trimesh.Trimesh:
    """Return three sharp steps along x, whose outline is the same at all y."""
    outline = [(STEPS_END_MM[0], 0.0)]
    for number, (low, high) in enumerate(pairwise(STEPS_END_MM)):
        top = FOOT_MM + number * STEP_MM
        outline += [(low, top), (high, top)]
    outline.append((STEPS_END_MM[-1], 0.0))
    count = len(outline)
    corners = np.concatenate(
        [np.insert(np.array(outline), 1, y, axis=1) for y in (-WIDTH_MM / 2, WIDTH_MM / 2)]
    )
    sides = [
        face
        for i, j in ((i, (i + 1) % count) for i in range(count))
        for face in ((i, j, count + j), (i, count + j, count + i))
    ]
    # From the foot of the highest step the whole outline is visible.
    caps = [(count - 1, i + 1, i) for i in range(count - 2)]
    caps += [(2 * count - 1, count + i, count + i + 1) for i in range(count - 2)]
    return trimesh.Trimesh(corners, [*sides, *caps])


def stairs(folder: Path) -> Settings:
    """Return the settings of the stairs; the mesh is written to a folder."""
    stairs_mesh().export(folder / "stairs.stl")
    return {"specimen": {"kind": "mesh", "file": str(folder / "stairs.stl")}, **SHEET}


def measured_objects(settings: Settings, texture: Settings, seeds: int) -> Iterator[MeasuredObject]:
    """Measure and compensate one body with several coats and noises; it is pressed once."""
    memory = Memory()
    for seed in range(seeds):
        experiment = load_experiment(BASE, {**settings, **CAMERA, **texture, "seed": 1000 + seed})
        done = measure(experiment, memory=memory, trial=seed)
        assert done.pressed is not None
        yield compensated(experiment, done.pressed, done.fringes.reconstruction.point_map)


def compensated(
    experiment: Experiment, pressed: PressedElastomer, coat: PointMap
) -> MeasuredObject:
    """Compensate a coat with the true sheet, and compare the points with the true object."""
    texture = experiment.coating.texture
    texture_mm = 0.0 if texture is None else 1e-3 * texture.rms_um
    layer = sensor_layer_of(experiment)
    known = LayerSigma(texture_mm=texture_mm, young_modulus_kpa=0.0)
    layer = layer.model_copy(update={"sigma": known})
    points = object_points(coat, compensate_points(coat, layer), texture_mm)
    place = points.points_world_mm[points.valid].astype(np.float64)
    lift_mm = pressed.depth_mm + experiment.elastomer.touched_plane_mm
    true = TrueSurface(shape_of(experiment.specimen), lift_mm)
    normal = normals_of(place, true.distance_mm)
    noise, whole = (
        of[points.valid].astype(np.float64) for of in (coat.sigma_xyz_mm, points.sigma_xyz_mm)
    )
    # Contributions along the normal, and the noise of the coat's point, projected on the normal.
    along = np.sum(whole**2, axis=1) - np.sum(noise**2, axis=1)
    sigma = np.sqrt(np.maximum(along, 0.0) + np.sum((normal * noise) ** 2, axis=1))
    cell_mm2 = (pressed.x_mm[1] - pressed.x_mm[0]) * (pressed.y_mm[1] - pressed.y_mm[0])
    force_n = 1e-3 * float(pressed.pressure_kpa.sum()) * cell_mm2
    error = nearest(true.distance_mm(place), place[:, 2] - plate_mm(experiment, lift_mm))
    return MeasuredObject(error, sigma, force_n / pressed.force_n)


def plate_mm(experiment: Experiment, lift_mm: float) -> float:
    """Return world z of the plate on which a mesh rests; far below for other specimens."""
    if experiment.specimen.kind != "mesh":
        return -np.inf
    file = str(experiment.specimen.model_dump()["file"])
    return lift_mm - float(np.ptp(trimesh.load_mesh(file).bounds[:, 2]))


def nearest(of_body: FloatArray, of_plate: FloatArray) -> FloatArray:
    """Return the distances of the smaller size, (n,), from the body or from its plate."""
    return np.where(np.abs(of_plate) < np.abs(of_body), of_plate, of_body)


def farthest_from_1(values: list[float]) -> float:
    return max(values, key=lambda value: abs(value - 1))


def normalised_of_bodies(folder: Path, seeds: int) -> tuple[list[float], list[float]]:
    """Return the normalised RMS of each body and coat, and pressure over force of each press."""
    normalised, ratios = [], []
    for name, settings in bodies(folder).items():
        for coat, texture in {"smooth": {}, "texture": TEXTURE}.items():
            objects = list(measured_objects(settings, texture, seeds))
            each = [rms(of.normalised) for of in objects]
            normalised.append(rms(np.concatenate([of.normalised for of in objects])))
            ratios += [of.pressure_over_force for of in objects]
            print(f"{name}, {coat}: {normalised[-1]:.3f}, seeds {np.round(each, 2)}", flush=True)
    return normalised, ratios


def wrong_on_stairs(folder: Path, seeds: int) -> tuple[float, list[float]]:
    """Return the share of wrong points on stairs, and pressure over force of each press."""
    wrong, ratios = [], []
    for load in STAIRS:
        for texture in ({}, TEXTURE):
            objects = list(measured_objects(stairs(folder) | load, texture, seeds))
            over = np.abs(np.concatenate([of.normalised for of in objects]))
            wrong.append(over > WRONG_SIGMAS)
            ratios += [of.pressure_over_force for of in objects]
            print(f"stairs: {len(over)} points, {wrong[-1].sum()} of them wrong", flush=True)
    return float(np.concatenate(wrong).mean()), ratios


def coat_compensation(quick: bool) -> dict[str, float]:
    """Return the figures of the module docstring."""
    seeds = QUICK_SEEDS if quick else SEEDS
    with tempfile.TemporaryDirectory() as folder:
        normalised, of_bodies = normalised_of_bodies(Path(folder), seeds)
        wrong, of_stairs = wrong_on_stairs(Path(folder), seeds)
    return {
        "compensated_normalised": farthest_from_1(normalised),
        "span_share_wrong": wrong,
        "pressure_over_force": farthest_from_1(of_bodies + of_stairs),
    }


def main() -> None:
    print_figures(coat_compensation(quick_parser(__doc__ or "", "2 seeds").parse_args().quick))


if __name__ == "__main__":
    main()

"""Where a specimen's features lie, and which quantities it has by nature: radius, step, groove.

A feature's own frame: x across it, y along it, as its specimen's.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation import BarPlace
from reconstruction.errors import InputError
from twin.config.measurands import ObjectMeasurand
from twin.config.models import Experiment
from twin.config.specimen_base import Specimen
from twin.config.specimens import (
    Ball,
    Bars,
    Grating,
    Group,
    Rod,
    Rods,
    Step,
    TwoBalls,
    VGroove,
)
from twin.specimens import Shape, Sphere, shape_of
from twin.specimens.catalogue import Placement, pose_of


@dataclass(frozen=True, eq=False)
class Feature:
    """One specimen, alone or as part of a group.

    Attributes
    ----------
    name : of the part; empty for a specimen that is no group
    world_from_own : its pose
    shape : in the world's x and y
    """

    name: str
    specimen: Specimen
    world_from_own: Placement
    shape: Shape

    def own(self, points_mm: FloatArray) -> FloatArray:
        """Return world points (n, xyz) in the feature's own frame: heights are across it."""
        own: FloatArray = (points_mm - self.world_from_own.shift_mm) @ self.world_from_own.rotation
        return own

    @property
    def balls(self) -> tuple[Sphere, ...]:
        """Balls in world x and y, along the specimen's x axis."""
        return self.shape.spheres()


def features_of(specimen: Specimen) -> list[Feature]:
    """Return the parts of a specimen in the file's order; itself where it is no group."""
    if not isinstance(specimen, Group):
        return [Feature("", specimen, pose_of(specimen), shape_of(specimen))]
    whole = pose_of(specimen)
    return [
        Feature(name, part, pose_of(part).then(whole), shape_of(part).placed(whole))
        for name, part in specimen.parts.items()
    ]


def bars_of(specimen: Specimen) -> list[BarPlace]:
    """Return where bars lie on the stage, in the file's order, their edges taken as exact."""
    return [place for one in features_of(specimen) for place in bar_places(one)]


def bar_places(feature: Feature) -> list[BarPlace]:
    """Return where the bars of a feature are on the stage; none where it has no bars."""
    bars, pose = feature.specimen, feature.world_from_own
    if not isinstance(bars, Bars):
        return []
    along = pose.rotation[:, 1]
    middles = [pose.apply(np.array([across_mm, 0.0, 0.0])) for across_mm in bars.middles_mm]
    return [
        BarPlace(
            x_mm=float(middle[0]),
            y_mm=float(middle[1]),
            along_deg=float(np.rad2deg(np.arctan2(-along[0], along[1]))),
            width_mm=width_mm,
            length_mm=bars.length_mm,
            edge_radius_mm=bars.edge_radius_mm,
        )
        for middle, width_mm in zip(middles, bars.widths_mm, strict=True)
    ]


def gratings_of(specimen: Specimen) -> tuple[Feature, ...]:
    """Return the parts of a specimen that are gratings."""
    return tuple(one for one in features_of(specimen) if isinstance(one.specimen, Grating))


def feature_of(features: list[Feature], asked: ObjectMeasurand) -> Feature:
    """Return the part that a measurand means.

    Raises
    ------
    InputError : there is no such part
    """
    if not asked.part:
        return features[0]
    for one in features:
        if one.name == asked.part:
            return one
    names = ", ".join(one.name for one in features if one.name) or "none, the specimen is no group"
    raise InputError(f"measurand {asked.name}: part: found '{asked.part}', allowed: {names}")


def measurands_of(experiment: Experiment) -> list[ObjectMeasurand]:
    """Return what is asked of an experiment, after what its specimen has by nature.

    One asked for under the name of a natural one, or for the same of it, takes its place.
    """
    asked = {one.name: one for one in experiment.measurand}
    same = {(one.quantity, one.part, one.number) for one in experiment.measurand}
    natural = {
        one.name: one
        for part in features_of(experiment.specimen)
        for one in _natural(part)
        if (one.quantity, one.part, one.number) not in same
    }
    return list((natural | asked).values())


def check_measurands(experiment: Experiment) -> None:
    """Refuse measurands that the specimen cannot have, before anything is measured.

    Raises
    ------
    InputError : a part, a ball, a rod, a bar or a grating that is not there
    """
    features = features_of(experiment.specimen)
    for asked in experiment.measurand:
        feature = feature_of(features, asked)
        kind = getattr(feature.specimen, "kind", "specimen")
        count = _how_many(feature, asked)
        if count is not None and asked.number > count:
            raise InputError(
                f"measurand {asked.name}: {asked.quantity} number {asked.number}: the specimen "
                f"({kind}) has {count or 'none'}; ask for another quantity, number or part"
            )
        if asked.quantity == "resolution" and not gratings_of(experiment.specimen):
            raise InputError(
                f"measurand {asked.name}: resolution is that of gratings, found {kind}; use kind = "
                "'grating', or a group of several pitches"
            )


def _how_many(feature: Feature, asked: ObjectMeasurand) -> int | None:
    """Return how many features of the kind there are; None where they are not counted."""
    own = feature.specimen
    if asked.quantity == "radius":
        if isinstance(own, Rods):
            return len(own.diameters_mm)
        return 1 if isinstance(own, Rod) else len(feature.balls)
    return len(own.widths_mm) if asked.quantity == "width" and isinstance(own, Bars) else None


def nominal_mm(feature: Feature, asked: ObjectMeasurand) -> float | None:
    """Return a length as the specimen's description has it; None where it does not."""
    if asked.nominal_mm is not None:
        return asked.nominal_mm
    own, at = feature.specimen, asked.number - 1
    known: dict[str, tuple[float, ...]] = {}
    if isinstance(own, Ball | TwoBalls):
        known["radius"] = tuple(ball.radius_mm for ball in feature.balls)
    elif isinstance(own, Rod):
        known["radius"] = (own.diameter_mm / 2,)
    elif isinstance(own, Rods):
        known["radius"] = tuple(d / 2 for d in own.diameters_mm)
    elif isinstance(own, Bars):
        known = {"width": own.widths_mm, "step_height": (own.height_mm,)}
    elif isinstance(own, Step):
        known["step_height"] = (own.height_mm,)
    elif isinstance(own, VGroove):
        known = {"depth": (own.depth_mm,), "width": (own.opening_mm,)}
    elif isinstance(own, Grating):
        known["depth"] = (own.groove_mm,)
    values = known.get(asked.quantity, ())
    return values[at] if at < len(values) else None


def _natural(feature: Feature) -> Iterator[ObjectMeasurand]:
    own, before = feature.specimen, _prefix(feature.name)

    def one(name: str, quantity: str, number: int = 1) -> ObjectMeasurand:
        return ObjectMeasurand.model_validate(
            {"name": f"{before}{name}", "quantity": quantity, "part": feature.name}
            | {"number": number}
        )

    if isinstance(own, Ball | TwoBalls):
        for number in range(1, len(feature.balls) + 1):
            yield one(f"radius_{number}", "radius", number)
    elif isinstance(own, Rod):
        yield one("radius_1", "radius")
    elif isinstance(own, Rods):
        for number in range(1, len(own.diameters_mm) + 1):
            yield one(f"radius_{number}", "radius", number)
    elif isinstance(own, Bars):
        for number in range(1, len(own.widths_mm) + 1):
            yield one(f"width_{number}", "width", number)
        yield one("step_height", "step_height")
    elif isinstance(own, Step):
        yield one("step_height", "step_height")
    elif isinstance(own, VGroove):
        yield one("depth", "depth")
        yield one("width", "width")
    elif isinstance(own, Grating):
        yield one("depth", "depth")
        # One for all gratings of a group: under the same name they are one.
        yield ObjectMeasurand(name="resolution", quantity="resolution")


def _prefix(part: str) -> str:
    """Return a part's name as the beginning of a measurand's."""
    if not part:
        return ""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in part.lower())
    return f"{plain[:20]}_" if plain[0].isalpha() else f"part_{plain[:15]}_"

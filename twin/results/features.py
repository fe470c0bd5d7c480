"""Where a specimen's features lie, and which quantities it has by nature: radius, step, groove.

A feature's own frame: x across it, y along it, as its specimen's.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation import BarPlace
from reconstruction.errors import InputError
from twin.config.measurands import ObjectMeasurand, Quantity
from twin.config.models import Experiment
from twin.config.nominal import NominalBar, NominalGrating
from twin.config.specimen_base import Specimen
from twin.shape import Placement, Shape, Sphere
from twin.specimens import shape_of
from twin.specimens.catalogue import pose_of


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
    if not specimen.components:
        return [Feature("", specimen, pose_of(specimen), shape_of(specimen))]
    whole = pose_of(specimen)
    return [
        Feature(name, part, pose_of(part).then(whole), shape_of(part).placed(whole))
        for name, part in specimen.components.items()
    ]


def bars_of(specimen: Specimen) -> list[BarPlace]:
    """Return the places of bars on the stage, in the file's order, their edges taken as exact."""
    return [place for one in features_of(specimen) for place in bar_places(one)]


def bar_places(feature: Feature) -> list[BarPlace]:
    """Return where the bars of a feature are on the stage; none where it has no bars."""
    pose = feature.world_from_own
    return [_bar_place(bar, pose) for bar in feature.specimen.nominal(NominalBar)]


def _bar_place(bar: NominalBar, pose: Placement) -> BarPlace:
    middle, along = pose.apply(np.array([bar.middle_mm, 0.0, 0.0])), pose.rotation[:, 1]
    return BarPlace(
        x_mm=float(middle[0]),
        y_mm=float(middle[1]),
        along_deg=float(np.rad2deg(np.arctan2(-along[0], along[1]))),
        width_mm=bar.width_mm,
        length_mm=bar.length_mm,
        edge_radius_mm=bar.edge_radius_mm,
    )


def gratings_of(specimen: Specimen) -> tuple[Feature, ...]:
    """Return the parts of a specimen that are gratings."""
    return tuple(one for one in features_of(specimen) if one.specimen.nominal(NominalGrating))


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
        kind = feature.specimen.kind
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
    """Return the number of features of a quantity; None where they are not counted."""
    known = _lengths_mm(feature.specimen, asked.quantity)
    if asked.quantity == "radius":
        return max(len(known), len(feature.balls))
    return len(known) or None if asked.quantity == "width" else None


def nominal_mm(feature: Feature, asked: ObjectMeasurand) -> float | None:
    """Return a length as the specimen's description has it; None where it does not."""
    if asked.nominal_mm is not None:
        return asked.nominal_mm
    known = _lengths_mm(feature.specimen, asked.quantity)
    return known[asked.number - 1] if asked.number <= len(known) else None


def _lengths_mm(specimen: Specimen, quantity: Quantity) -> list[float]:
    """Return the nominal lengths of a quantity, counted along x."""
    features = specimen.nominal_features()
    return [one.lengths_mm[quantity] for one in features if quantity in one.lengths_mm]


def _natural(feature: Feature) -> Iterator[ObjectMeasurand]:
    """Yield the measurands of a part that follow from its nominal features."""
    before, count = _prefix(feature.name), Counter[Quantity]()
    for nominal in feature.specimen.nominal_features():
        for quantity in nominal.lengths_mm:
            count[quantity] += 1
            number = f"_{count[quantity]}" if nominal.is_counted else ""
            yield ObjectMeasurand(
                name=f"{before}{quantity}{number}",
                quantity=quantity,
                part=feature.name,
                number=count[quantity],
            )
    if feature.specimen.nominal(NominalGrating):
        # The gratings of a group share this measurand: its name is the same for all of them.
        yield ObjectMeasurand(name="resolution", quantity="resolution")


def _prefix(part: str) -> str:
    """Return a part's name as the beginning of a measurand's."""
    if not part:
        return ""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in part.lower())
    return f"{plain[:20]}_" if plain[0].isalpha() else f"part_{plain[:15]}_"

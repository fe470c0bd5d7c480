"""Positions of a specimen's features: balls, bars, gratings, and the parts of a group.

In the own frame of a feature, x is across the feature and y along it, as in its specimen's frame.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation import BarPlace
from reconstruction.errors import InputError
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalBar, NominalGrating
from twin.config.specimen_base import Specimen
from twin.shape import Placement, Shape, Sphere
from twin.specimens import shape_of
from twin.specimens.catalogue import pose_of


@dataclass(frozen=True, eq=False)
class Feature:
    """One specimen in its pose: a single specimen, or a part of a group.

    Attributes
    ----------
    name : name of the part; empty if the specimen is not a group
    specimen : description of the specimen or part
    world_from_own : pose, which maps the feature's own frame to the world frame
    shape : geometry with x and y in the world frame
    """

    name: str
    specimen: Specimen
    world_from_own: Placement
    shape: Shape

    def own(self, points_mm: FloatArray) -> FloatArray:
        """Return points (n, xyz), mm, in the feature's own frame, given in the world frame."""
        own: FloatArray = (points_mm - self.world_from_own.shift_mm) @ self.world_from_own.rotation
        return own

    @property
    def balls(self) -> tuple[Sphere, ...]:
        """Balls, with x and y in the world frame, sorted along the specimen's x axis."""
        return self.shape.spheres()


def features_of(specimen: Specimen) -> list[Feature]:
    """Return the parts of a specimen in the order of its file, or the specimen if no group."""
    if not specimen.components:
        return [Feature("", specimen, pose_of(specimen), shape_of(specimen))]
    whole = pose_of(specimen)
    return [
        Feature(name, part, pose_of(part).then(whole), shape_of(part).placed(whole))
        for name, part in specimen.components.items()
    ]


def bars_of(specimen: Specimen) -> list[BarPlace]:
    """Return the nominal positions of all bars of a specimen, in the order of its file."""
    return [place for feature in features_of(specimen) for place in bar_places(feature)]


def bar_places(feature: Feature) -> list[BarPlace]:
    """Return the nominal positions of the bars of a feature; empty if it has no bars."""
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
    """Return the parts of a specimen that have a grating."""
    return tuple(
        feature for feature in features_of(specimen) if feature.specimen.nominal(NominalGrating)
    )


def feature_of(features: list[Feature], request: ObjectMeasurand) -> Feature:
    """Return the part that a measurand names; the first part if the measurand names none.

    Raises
    ------
    InputError : there is no such part
    """
    if not request.part:
        return features[0]
    for feature in features:
        if feature.name == request.part:
            return feature
    names = (
        ", ".join(feature.name for feature in features if feature.name)
        or "none, the specimen is no group"
    )
    raise InputError(f"measurand {request.name}: part: found '{request.part}', allowed: {names}")

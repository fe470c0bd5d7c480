"""Clear plane layers above the coat as data, such as a gel, its window, and gaps of air.

World frame: z = 0 is the undeformed coated face. Layers are horizontal and laterally unbounded.
There is air above the topmost layer and in gaps between layers. A layer with
its bottom at or below z = 0 contains the coat: it extends down to the deformed coat.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from twin.config.base import Model
from twin.config.bounds import Absorption, Length
from twin.config.methods import TRAITS

TOUCHING_MM = 1e-6
"""Layers with a smaller distance, mm, are in contact: no real air gap is 1 nm wide."""


class Layer(Model):
    """Plane-parallel, clear, optically smooth layer above the coat."""

    bottom_mm: Annotated[float, Field(ge=-1000, le=1000)] = Field(
        description="world z of its lower face; 0 or less: the layer contains the coat"
    )
    thickness_mm: Length
    ior: Annotated[float, Field(ge=1, le=3)] = Field(description="index of refraction against air")
    absorption_per_mm: Absorption = Field(
        default=0.0, description="Napierian coefficient of the bulk"
    )

    @property
    def top_mm(self) -> float:
        """World z of the upper face of the layer, mm."""
        return self.bottom_mm + self.thickness_mm


@dataclass(frozen=True)
class Medium:
    """Medium between a plane interface and the next interface below."""

    #: world z of the interface above the medium, mm
    top_mm: float
    ior: float
    absorption_per_mm: float


def media_of(layers: Mapping[str, Layer]) -> tuple[Medium, ...]:
    """Return the media below the topmost interface, from top to bottom, including gaps of air.

    The last medium contains the coat. It is a layer, or the air below the lowest layer.
    """
    media: list[Medium] = []
    descending = sorted(layers.values(), key=lambda layer: layer.top_mm, reverse=True)
    for layer, below in pairwise([*descending, None]):
        assert layer is not None
        media.append(Medium(layer.top_mm, layer.ior, layer.absorption_per_mm))
        next_mm = 0.0 if below is None else below.top_mm
        if layer.bottom_mm - next_mm > (TOUCHING_MM if below is not None else 0.0):
            media.append(Medium(layer.bottom_mm, 1.0, 0.0))
    return tuple(media)


def holding_layer(layers: Mapping[str, Layer]) -> Layer | None:
    """Return the layer that contains the coat; None if the coat is in air."""
    return next((layer for layer in layers.values() if layer.bottom_mm <= 0.0), None)


def raised_mm(layers: Mapping[str, Layer]) -> float:
    """Return how far the layers raise the coat, mm, as it appears from above in air (paraxial)."""
    return sum(layer.thickness_mm * (1.0 - 1.0 / layer.ior) for layer in layers.values())


@dataclass(frozen=True)
class OuterFace:
    """Upper interface to air of the stack of touching layers that contains the coat."""

    height_mm: float
    """World z of the interface, mm."""
    ior: float
    """Refractive index of the coat's medium; the angle in it determines reflection here."""


def outer_face(layers: Mapping[str, Layer]) -> OuterFace | None:
    """Return the face from which the layers reflect light onto the coat.

    None if the coat is in air.

    In plane layers in contact, n sin(angle) is constant. Therefore the index of the coat's medium
    determines which light the topmost layer transmits.
    """
    height_mm, ior = 0.0, 1.0
    if holding_layer(layers) is not None:
        *above, within = media_of(layers)
        height_mm, ior = within.top_mm, within.ior
        for medium in reversed(above):
            if medium.ior == 1.0:
                break
            height_mm = medium.top_mm
    return OuterFace(height_mm, ior) if ior > 1.0 else None


def _in_order(layers: dict[str, Layer]) -> dict[str, Layer]:
    ascending = sorted(layers.items(), key=lambda item: item[1].bottom_mm)
    for name, layer in ascending:
        if layer.top_mm <= 0.0:
            raise ValueError(
                f"{name} ends at {layer.top_mm:g} mm, below the opaque coat at 0; remove it"
            )
    for (name, layer), (upper_name, above) in pairwise(ascending):
        if above.bottom_mm < layer.top_mm - TOUCHING_MM:
            raise ValueError(
                f"{name} ends at {layer.top_mm:g} mm, {upper_name} starts below that, at "
                f"{above.bottom_mm:g} mm; raise {upper_name}.bottom_mm or make {name} thinner"
            )
    return layers


def check_rig(layers: Mapping[str, Layer], tables: Mapping[str, Any]) -> None:
    """Raise ValueError if layers contradict other tables of the experiment.

    Parameters
    ----------
    layers : the layers by name
    tables : those tables of the experiment, by name, that are valid

    Raises
    ------
    ValueError : one line: key, found, allowed, remedy
    """
    if not layers:
        return
    if "modality" in tables and not TRAITS[tables["modality"]].presses:
        raise ValueError(
            f"modality = '{tables['modality']}' images through air only; remove the layers"
        )
    if "render" in tables:
        _check_render(tables["render"])
    for device in ("camera", "projector"):
        if device in tables:
            top_mm = max(layer.top_mm for layer in layers.values())
            _check_height(device, tables[device].pose, top_mm)
    if "elastomer" in tables and tables["elastomer"].layout == "contact_face":
        _check_gel(layers, tables["elastomer"].thickness_mm)


def _check_render(render: Any) -> None:
    if render.bounces:
        raise ValueError(
            f"render.bounces = {render.bounces}: light reflected by the layers is not traced; "
            "set render.bounces = 0"
        )
    if render.engine == "stock":
        raise ValueError(
            "render.engine = 'stock': stock Mitsuba cannot connect a coat below a refracting "
            "face to the projector; set render.engine = 'one_trace'"
        )


def _check_height(device: str, pose: Any, top_mm: float) -> None:
    height_mm = pose.standoff_mm * math.cos(math.radians(pose.polar_deg))
    if height_mm <= top_mm:
        raise ValueError(
            f"the topmost ends at {top_mm:g} mm, allowed below the {device} at "
            f"{height_mm:.4g} mm; lower it, or enlarge {device}.pose.standoff_mm"
        )


def _check_gel(layers: Mapping[str, Layer], thickness_mm: float) -> None:
    gel = holding_layer(layers)
    if gel is None or abs(gel.top_mm - thickness_mm) > TOUCHING_MM:
        fault = "found no layer round the coat"
        if gel is not None:
            fault = f"found the top of the coat's layer at {gel.top_mm:g}"
        raise ValueError(
            f"{fault}; elastomer.layout = 'contact_face' needs the gel: bottom_mm = 0, "
            f"thickness_mm = {thickness_mm:g} as elastomer.thickness_mm"
        )


Layers = Annotated[dict[str, Layer], AfterValidator(_in_order)]

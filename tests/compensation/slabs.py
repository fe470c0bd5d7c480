"""Coats of objects pressed into a thick slab by the spectral model on a finer grid, with noise."""

from functools import cache

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.elastomer import Elastomer
from twin.config.models import AnySpecimen, Press
from twin.config.sensor_layer import MeasuredLoad, SensorLayer
from twin.config.sigma import LayerSigma
from twin.mechanics.slab_tangent import SolvedSlab, solve_slab

MODULUS_KPA = 400.0
SPAN_MM, WIDE_MM = 12.8, 16.0
FINE_MM = 0.04
COAT_CELL_MM = 0.1


def slab(
    thickness_mm: float = 3.0, modulus_kpa: float = MODULUS_KPA, span_mm: float = SPAN_MM
) -> Elastomer:
    """Return a slab on a simply supported square rim."""
    return Elastomer(
        thickness_mm=thickness_mm,
        length_x_mm=span_mm,
        length_y_mm=span_mm,
        young_modulus_kpa=modulus_kpa,
        poisson_ratio=0.49,
    )


def layer_of(elastomer: Elastomer, air_kpa: float = 0.0, **sigma: float) -> SensorLayer:
    """Return the known values of a slab; its modulus is exact unless a sigma is given."""
    return SensorLayer(
        elastomer=elastomer,
        press=MeasuredLoad(back_pressure_kpa=air_kpa),
        sigma=LayerSigma(**{"young_modulus_kpa": 0.0} | sigma),
    )


def with_load(layer: SensorLayer, sigma: dict[str, float], **load: float) -> SensorLayer:
    """Return a layer with the travel or force of the press and their uncertainty."""
    changed = {"press": layer.press.model_copy(update=load)}
    return layer.model_copy(update=changed | {"sigma": layer.sigma.model_copy(update=sigma)})


@cache
def pressed(
    specimen: AnySpecimen, elastomer: Elastomer, depth_mm: float, air_kpa: float = 0.0,
    pitch_mm: float = FINE_MM,
) -> SolvedSlab:  # fmt: skip
    """Press a specimen into a slab; the same press is solved once. Not to be changed by tests."""
    load = Press(
        control="depth", depth_mm=depth_mm, back_pressure_kpa=air_kpa, solver_pitch_mm=pitch_mm
    )
    cells = round(elastomer.length_x_mm / COAT_CELL_MM)
    return solve_slab(specimen, elastomer, load, (cells, cells))


def coat_points(
    heights_mm: FloatArray, noise_mm: float, seed: int = 0, span_mm: float = SPAN_MM
) -> tuple[FloatArray, FloatArray]:
    """Return points (n, xyz) of a coat at the middles of its cells, and their sigma (n,)."""
    count = len(heights_mm)
    places = (np.arange(count) + 0.5) * (span_mm / count) - span_mm / 2
    x, y = np.meshgrid(places, places)
    z = heights_mm + np.random.default_rng(seed).normal(scale=noise_mm, size=x.shape)
    return np.stack((x, y, z), axis=-1).reshape(-1, 3), np.full(x.size, noise_mm)

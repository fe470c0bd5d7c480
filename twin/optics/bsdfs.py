"""Parts of BSDF dictionaries for `mi.load_dict` that several kinds share."""

from typing import Any


def level(value: float) -> dict[str, Any]:
    """Return a number as a spectrum; `mi.load_dict` would read a plain number as a colour."""
    return {"type": "spectrum", "value": value}


def microfacets(kind: str, roughness: float, **index: Any) -> dict[str, Any]:
    """Return a smooth surface of a Mitsuba plug-in, or its rough form with GGX microfacets."""
    if roughness == 0.0:
        return {"type": kind, **index}
    return {"type": f"rough{kind}", "distribution": "ggx", "alpha": roughness, **index}


def fresnel_at_normal(n: float, k: float = 0.0) -> float:
    """Return the reflectance at normal incidence of a complex index n + ik against air."""
    return ((n - 1.0) ** 2 + k**2) / ((n + 1.0) ** 2 + k**2)

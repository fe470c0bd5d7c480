"""Parts of BSDF dictionaries for `mi.load_dict` that several coats and materials share."""

from typing import Any


def level(value: float) -> dict[str, Any]:
    """Return the dictionary of a constant spectrum for `mi.load_dict`.

    `mi.load_dict` would read a number without this dictionary as a colour.
    """
    return {"type": "spectrum", "value": value}


def microfacets(kind: str, roughness: float, **index: Any) -> dict[str, Any]:
    """Return the dictionary of a smooth BSDF, or of its rough form with GGX microfacets.

    Parameters
    ----------
    kind : name of Mitsuba's plug-in for the smooth surface, for example "conductor"
    roughness : GGX alpha; 0 is a smooth surface
    index : further parameters of the plug-in, such as refractive indices
    """
    if roughness == 0.0:
        return {"type": kind, **index}
    return {"type": f"rough{kind}", "distribution": "ggx", "alpha": roughness, **index}


def fresnel_at_normal(n: float, k: float = 0.0) -> float:
    """Return the Fresnel reflectance at normal incidence, in air, of a material of index n + ik."""
    return ((n - 1.0) ** 2 + k**2) / ((n + 1.0) ** 2 + k**2)

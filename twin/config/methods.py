"""The methods by name, and what distinguishes them; nothing else compares their names."""

from dataclasses import dataclass
from typing import Literal, get_args

Method = Literal["direct_fpp", "contact_fpp", "photometric_stereo"]


@dataclass(frozen=True)
class MethodTraits:
    """What a method does, as far as others must know.

    Attributes
    ----------
    title, told : what pages call it, and how they explain it
    presses : it looks at a coat that is pressed onto the specimen, not at the bare specimen
    fringes : it projects a sequence of fringes; if not, lamps beside the gel light one image
    """

    title: str
    told: str
    presses: bool
    fringes: bool


TRAITS: dict[Method, MethodTraits] = {
    "direct_fpp": MethodTraits(
        "direct FPP", "fringes on the bare specimen", presses=False, fringes=True
    ),
    "contact_fpp": MethodTraits(
        "contact-FPP", "fringes on the coat pressed onto it", presses=True, fringes=True
    ),
    "photometric_stereo": MethodTraits(
        "photometric stereo",
        "the coat of a gel on a window, in coloured light, pressed onto it",
        presses=True,
        fringes=False,
    ),
}
METHODS: tuple[Method, ...] = get_args(Method)

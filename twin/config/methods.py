"""Measuring methods by name, and their traits; other modules compare traits, not names."""

from dataclasses import dataclass
from typing import Literal, get_args

Method = Literal["direct_fpp", "contact_fpp", "photometric_stereo"]


@dataclass(frozen=True)
class MethodTraits:
    """Traits of a measuring method on which other modules depend.

    Attributes
    ----------
    title, explanation : name and explanation of the method on report pages
    presses : True: the method images a coat that is pressed onto the specimen; False: the bare
        specimen
    fringes : True: the method projects a sequence of fringes; False: it takes one image in the
        light of lamps at the sides of the gel
    """

    title: str
    explanation: str
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

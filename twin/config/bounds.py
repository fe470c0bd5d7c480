"""Physical ranges of the quantities of an experiment, each with its reason.

`twin keys` prints the range and its reason; the error about a value outside the range does so,
too. The ranges are wide. They exclude values that no sensor, gel or light source has, and values
for which the models of this project (geometrical optics, continuum mechanics, double precision)
are invalid. The data file of a product states a narrower range.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field

from reconstruction.pixel_shape import PIXEL_RATIOS


@dataclass(frozen=True)
class Because:
    """Reason for the limits of a range, attached to an annotated type as metadata."""

    reason: str


def zero_or_at_least(least: float) -> Callable[[float], float]:
    """Return a function that raises ValueError for numbers between 0 and `least`.

    0 is allowed; a number below `least` would have no effect.
    """

    def check(value: float) -> float:
        if 0 < value < least:
            raise ValueError(f"allowed 0 or at least {least:g}")
        return value

    return check


# ---- lengths -----------------------------------------------------------------------------------

_LENGTHS = Because("0.1 um, below which light is no ray, to 1 m, more than any tactile sensor")
LENGTH_RANGE_MM = (1e-4, 1000.0)
Length = Annotated[float, Field(ge=LENGTH_RANGE_MM[0], le=LENGTH_RANGE_MM[1]), _LENGTHS]
Place = Annotated[float, Field(ge=-1000, le=1000), Because("within 1 m of the sensor's centre")]
Rounding = Annotated[float, Field(ge=0, le=1000), _LENGTHS]
#: length of a part of a specimen, mm
Size = Annotated[
    float,
    Field(ge=1e-4, le=100),
    Because("0.1 um, below which light is no ray, to 100 mm, the space under the sensor"),
]
#: length of a part of a specimen, mm; 0: the specimen does not have the part
OptionalSize = Annotated[
    float, Field(ge=0, le=100), Because("100 mm is the space under the sensor")
]
FileUnit = Annotated[
    float, Field(ge=1e-6, le=1e6), Because("files are drawn in units from the nanometre to the km")
]
#: figure of merit, um
Micrometres = Annotated[float, Field(ge=0, le=1e6), Because("1 m is more than any sensor measures")]
Tolerance = Annotated[float, Field(gt=0, le=1e6), Because("1 m is more than any sensor measures")]
Limit = Annotated[float, Field(ge=-1e6, le=1e6), Because("1 m is more than any sensor measures")]

#: figure of a result, in the unit that its name states, or a number of an experiment
Figure = Annotated[float, Field(ge=-1e12, le=1e12), Because("no key and no figure is larger")]
FigureSigma = Annotated[
    float,
    Field(ge=1e-12, le=1e12),
    Because("no figure is so well known, and none is larger"),
]
#: standard deviation or half width of a distribution; 0: none
Spread = Annotated[float, Field(ge=0, le=1e12), Because("no key and no figure is larger")]

# ---- mechanics ---------------------------------------------------------------------------------

Modulus = Annotated[
    float,
    Field(ge=1, le=1e7),
    Because("1 kPa, jelly that barely keeps its shape, to 10 GPa, a glassy polymer"),
]
FilmModulus = Annotated[
    float, Field(ge=1, le=4e8), Because("1 kPa, jelly, to 400 GPa, a film of hard metal")
]
Travel = Annotated[
    float,
    Field(ge=1e-6, le=100),
    Because("1 nm, a few atoms, to 100 mm, the height of the largest specimen"),
]
Force = Annotated[
    float,
    Field(ge=1e-6, le=1e4),
    Because("1 uN, the weight of a grain of dust, to 10 kN, the weight of a car"),
]
#: travel of a specimen along the touched face, mm; its sign is the direction
SlideTravel = Annotated[
    float, Field(ge=-100, le=100), Because("100 mm is the width of the largest specimen")
]
HoldTime = Annotated[
    float, Field(ge=0, le=1e8), Because("1e8 s is three years, longer than any measurement waits")
]
AirPressure = Annotated[
    float,
    Field(ge=0, le=1000),
    AfterValidator(zero_or_at_least(1e-4)),
    Because("1000 kPa is a workshop's compressed air, below 0.1 Pa there is none"),
]
RimCompliance = Annotated[
    float,
    Field(ge=0, le=100),
    AfterValidator(zero_or_at_least(1e-3)),
    Because("a sheet's own is 10 and more; below 0.001 a rim is rigid: give 0"),
]
ModulusSigma = Annotated[float, Field(ge=0, le=1e7), Because("10 GPa is the modulus of no gel")]
ForceSigma = Annotated[float, Field(ge=0, le=1e4), Because("10 kN is the weight of a car")]
Tack = Annotated[
    float,
    Field(ge=0, le=1000),
    AfterValidator(zero_or_at_least(1e-6)),
    Because("1000 J/m^2 peels a strong adhesive tape, below 1e-6 adhesion has no effect"),
]

# ---- optics ------------------------------------------------------------------------------------

Photons = Annotated[
    int, Field(ge=1000, le=10**8), Because("each takes 50 bytes of memory: 1e8 of them 5 GB")
]
MetalIndex = Annotated[
    float, Field(ge=0.01, le=20), Because("metals have 0.04 (silver) to 8, from 300 to 1100 nm")
]
Extinction = Annotated[
    float, Field(ge=0, le=50), Because("metals have up to 11 (aluminium), from 300 to 1100 nm")
]
Absorption = Annotated[
    float,
    Field(ge=0, le=1e4),
    Because("above 1e4 per mm light ends within 0.1 um: a metal, not a clear body"),
]
Flux = Annotated[
    float,
    Field(ge=1e-12, le=1e6),
    Because("1 fW, some thousand photons per second, to 1 kW, a cinema projector"),
]
Irradiance = Annotated[float, Field(ge=0, le=1e4), Because("1e4 mW/mm^2 burns the coat")]
ThrowRatio = Annotated[
    float, Field(ge=0.05, le=100), Because("projection lenses have 0.2 (wall-mounted) to 10")
]
PixelWidth = Annotated[
    float,
    Field(ge=PIXEL_RATIOS[0], le=PIXEL_RATIOS[1]),
    Because("chips have 1; patterns of half the columns or rows 2 or 0.5"),
]
Contrast = Annotated[
    float, Field(gt=1, le=1e9), Because("above 1e9 black is darker than any camera measures")
]
LightDrift = Annotated[
    float, Field(ge=-50, le=50), Because("a lamp that loses more than half of its light is broken")
]
DriftFrames = Annotated[
    float, Field(ge=0.1, le=1e5), Because("0.1 frames is over before the second, 1e5 is linear")
]
Flicker = Annotated[
    float, Field(ge=0, le=10), Because("at 10 % some frames have light less by a third")
]
DitherPeriods = Annotated[
    float, Field(ge=0.05, le=1e5), Because("the light of a few mirror states, to a steady level")
]
# OpenCV's coefficients, for x = image height / focal length: up to 1.7 for 120 deg of view, and
# 0.05 for a telephoto lens, for which k3 x^6 exceeds one pixel from about k3 = 1e4.
DistortionCoefficient = Annotated[
    float,
    Field(ge=-1e6, le=1e6),
    Because("at 1e6 even k3 of a telephoto lens moves its corner by a hundredth of the image"),
]
Distortion = tuple[
    DistortionCoefficient,
    DistortionCoefficient,
    DistortionCoefficient,
    DistortionCoefficient,
    DistortionCoefficient,
]

# ---- camera ------------------------------------------------------------------------------------

PixelPitch = Annotated[
    float,
    Field(ge=0.1, le=1000),
    Because("0.1 um, below which a pixel is smaller than its light's wavelength, to 1 mm"),
]
EXPOSURE_RANGE_MS = (1e-4, 1e6)
EXPOSURE_PERCENTILE = 99.5
"""Percentile of the white frame's pixel values that automatic exposure sets to `auto_level`."""
Exposure = Annotated[
    float,
    Field(ge=EXPOSURE_RANGE_MS[0], le=EXPOSURE_RANGE_MS[1]),
    Because("100 ns, an electronic shutter, to 1000 s, the longest of a cooled camera"),
]
F_NUMBER_RANGE = (0.7, 64.0)
#: focal length over diameter of the pupil
FNumber = Annotated[float, Field(ge=F_NUMBER_RANGE[0], le=F_NUMBER_RANGE[1])]
Magnification = Annotated[
    float, Field(ge=1e-3, le=100), Because("0.001, a photograph, to 100, a microscope objective")
]
#: images or patterns per second
Rate = Annotated[
    float, Field(ge=1e-3, le=1e6), Because("1 MHz is above the fastest cameras and projectors")
]
FullWell = Annotated[
    float, Field(ge=1, le=1e9), Because("1 electron to 1e9, above the largest photodiodes' wells")
]
ReadNoise = Annotated[float, Field(ge=0, le=1e6), Because("1e6 electrons hide any image")]
DarkCurrent = Annotated[
    float, Field(ge=0, le=1e9), Because("1e9 electrons per second fill any well within a frame")
]
BlackLevel = Annotated[float, Field(ge=0, lt=2**16 - 1), Because("the largest code of 16 bits")]
ResponseSpread = Annotated[
    float, Field(ge=0, le=25), Because("above 25 % some pixels would respond to light negatively")
]
ScatteredShare = Annotated[
    float, Field(ge=0, le=40), Because("a lens that scatters 40 % is fogged, not a camera's")
]
GlareWidth = Annotated[
    float,
    Field(ge=1, le=100),
    Because("below 1 % of the image width it is blur of the lens, above 100 % stray light"),
]
FilterWidth = Annotated[
    float, Field(ge=0.1, le=100), Because("0.1 px is no filter, 100 px is wider than any object")
]

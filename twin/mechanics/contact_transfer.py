"""What the coat still shows of a groove: contrast against pitch, closed form and computed.

In the opposite-face layout thickness decides everything: whatever its hardness, a slab keeps half
the relief of a pitch of 2.40 thicknesses and a tenth at 1.32. In the contact-face layout the coat
is the touched face: while the groove is filled nothing is lost.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import FreeSlab
from twin.mechanics.layouts import coat_film
from twin.mechanics.transfer import opposite_transfer

_PITCHES_ACROSS = 8
_CELLS_PER_PITCH = 32
_Q_RANGE = 1e-3, 60.0


@dataclass(frozen=True)
class ContactTransfer:
    """How much of a sinusoidal relief the coated face keeps, per pitch."""

    #: (n,) mm
    pitch_mm: FloatArray
    #: (n,) T(q) of a slab without film, 0 to 1
    closed_form: FloatArray
    #: (n,) by the press' own solver, film included; of a sheet what pressure lets it show
    computed: FloatArray
    #: pitch of which half, and a tenth, is kept (slab: closed form; sheet: computed); 0 where
    #: nothing is lost
    half_pitch_mm: float
    tenth_pitch_mm: float
    thickness_mm: float
    #: of a sheet: what presses it onto ridges of which height
    pressure_kpa: float | None = None
    ridge_mm: float | None = None

    def rows(self) -> list[tuple[float, float, float]]:
        """Return (pitch mm, closed form, computed) per pitch, for tables."""
        return list(
            zip(
                self.pitch_mm.tolist(),
                self.closed_form.tolist(),
                self.computed.tolist(),
                strict=True,
            )
        )


def contact_transfer(elastomer: Elastomer, pitches_mm: FloatArray | None = None) -> ContactTransfer:
    """Return what the coated face keeps of a groove of each pitch.

    Parameters
    ----------
    elastomer : Elastomer
        The slab.
    pitches_mm : (n,) float, mm, optional
        Pitches; by default half to six thicknesses.

    Raises
    ------
    PressError
        A pitch that is not positive, or so long that the slab cannot be solved.
    """
    thickness = elastomer.thickness_mm
    default = thickness * np.geomspace(0.5, 6.0, 41)
    pitches = positive_pitches(default if pitches_mm is None else pitches_mm)
    if elastomer.layout == "contact_face":
        whole = np.ones_like(pitches)
        return ContactTransfer(pitches, whole, whole, 0.0, 0.0, thickness)
    return ContactTransfer(
        pitch_mm=pitches,
        closed_form=opposite_transfer(2 * np.pi * thickness / pitches),
        computed=np.array([_computed(elastomer, float(pitch)) for pitch in pitches]),
        half_pitch_mm=pitch_at(0.5, thickness),
        tenth_pitch_mm=pitch_at(0.1, thickness),
        thickness_mm=thickness,
    )


def positive_pitches(pitches_mm: FloatArray) -> FloatArray:
    """Return pitches as a (n,) array.

    Raises
    ------
    PressError
        One is not positive.
    """
    pitches = np.atleast_1d(np.asarray(pitches_mm, dtype=np.float64))
    if not (pitches > 0).all():
        raise PressError(f"pitch: found {pitches.min():g} mm, allowed: more than 0")
    return pitches


def pitch_at(kept: float, thickness_mm: float) -> float:
    """Return the pitch of which a free slab keeps the share `kept`, mm.

    >>> round(pitch_at(0.5, 1.0), 2)
    2.4
    """
    q = brentq(lambda q: float(opposite_transfer(np.array([q]))[0]) - kept, *_Q_RANGE)
    return 2 * np.pi * thickness_mm / float(q)


def _computed(elastomer: Elastomer, pitch_mm: float) -> float:
    """Press grooves of one pitch into a wide slab with the solver's own operators.

    The slab's spans hold whole waves, so that a wave of pressure gives the same wave on both
    faces; the second axis carries a wave so long that the pitch hardly changes, and that is
    corrected for.
    """
    wave = 2 * np.pi / pitch_mm
    length_x, length_y = _PITCHES_ACROSS * pitch_mm, 40.0 * pitch_mm
    k_y = np.pi / length_y
    k_x = np.sqrt(wave**2 - k_y**2)
    length_x = 2 * _PITCHES_ACROSS * np.pi / k_x
    slab = FreeSlab(
        rows=2 * _CELLS_PER_PITCH,
        cols=_PITCHES_ACROSS * _CELLS_PER_PITCH,
        length_x_mm=float(length_x),
        length_y_mm=length_y,
        thickness_mm=elastomer.thickness_mm,
        poisson_ratio=elastomer.poisson_ratio,
        film=coat_film(elastomer, young_modulus(elastomer).best_kpa),
    )
    across = np.sin(k_y * (slab.y_mm + length_y / 2))
    pressure = np.sin(k_x * (slab.x_mm + length_x / 2)) * across[:, None]
    touched, coated = slab.deflect(pressure), slab.deflect_opposite(pressure)
    return float(np.einsum("ij,ij", coated, pressure) / np.einsum("ij,ij", touched, pressure))

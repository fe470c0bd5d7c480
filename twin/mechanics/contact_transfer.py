"""Height of grooves and ridges on the coated face over their height on the specimen, by pitch.

In the opposite-face layout this ratio depends only on pitch over thickness: a slab of any hardness
transfers 50 % of the relief at a pitch of 2.40 thicknesses and 10 % at 1.32. In the contact-face
layout the coat is the touched face: a groove that the gel fills is transferred completely.

A slab, 3 mm thick, touches the whole surface of a shallow groove. A thin sheet touches only the
crests, and the pressure bends it into the grooves between them. Its ratio therefore also depends on
hardness and pressure. When the sheet touches the whole surface, its ratio is that of a slab, T(q).
The sheet is computed as one period of the exact elastic layer, which includes shear through the
thickness. The `sheet` press neglects this shear, which reduces the relief by 50 % at a pitch of 2
thicknesses. Ridges are cosines of x, constant along y. The tension of a sheet that is stretched
over the specimen is neglected; it reduces the relief.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, nnls

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer
from twin.config.specimen_base import Specimen
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.layer import FreeSlab
from twin.mechanics.layouts import coat_film
from twin.mechanics.transfer import opposite_transfer, solve_transfer

_PITCHES_ACROSS = 8
_CELLS_PER_PITCH = 32
_Q_RANGE = 1e-3, 60.0
#: ridge height of a fingerprint, the finest relief that the paper names
RIDGE_MM = 0.07
_CELLS = 128  # number of cells of half a pitch
_PITCHES = np.geomspace(1.0, 30.0, 31)  # pitches over the thickness
_RANGE = 0.2, 200.0  # bracket of the pitch for a given share, over the thickness
_STIFF = 1e4


@dataclass(frozen=True)
class ContactTransfer:
    """Height of a sinusoidal relief on the coated face over that on the specimen, by pitch."""

    #: (n,) mm
    pitch_mm: FloatArray
    #: (n,) share T(q), 0 to 1, of a slab without film
    closed_form: FloatArray
    #: (n,) share, 0 to 1, by the solver of the press, with the film; of a sheet: under its pressure
    computed: FloatArray
    #: pitches at which 50 % and 10 % are transferred (slab: closed form; sheet: computed); 0 if
    #: every pitch is transferred completely
    half_pitch_mm: float
    tenth_pitch_mm: float
    thickness_mm: float
    #: pressure that presses a sheet onto the ridges, and their height; None for a slab
    pressure_kpa: float | None = None
    ridge_mm: float | None = None

    def rows(self) -> list[tuple[float, float, float]]:
        """Return (pitch mm, closed form, computed) per pitch, for tables."""
        columns = (self.pitch_mm, self.closed_form, self.computed)
        return list(zip(*(column.tolist() for column in columns), strict=True))


def contact_transfer(elastomer: Elastomer, pitches_mm: FloatArray | None = None) -> ContactTransfer:
    """Return the share of a groove's depth that the coated face reproduces, for each pitch.

    Parameters
    ----------
    pitches_mm : (n,) float, mm; None: 41 pitches of 0.5 to 6 thicknesses

    Raises
    ------
    PressError : a pitch is not positive, or is too long for the slab to be solved
    """
    thickness = elastomer.thickness_mm
    default = thickness * np.geomspace(0.5, 6.0, 41)
    pitches = np.atleast_1d(default if pitches_mm is None else np.asarray(pitches_mm, float))
    if not (pitches > 0).all():
        raise PressError(f"pitch: found {pitches.min():g} mm, allowed: more than 0")
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


def pitch_at(share: float, thickness_mm: float) -> float:
    """Return the pitch, mm, at which a free slab transfers the fraction `share` of a relief.

    >>> round(pitch_at(0.5, 1.0), 2)
    2.4
    """
    q = brentq(lambda q: float(opposite_transfer(np.array([q]))[0]) - share, *_Q_RANGE)
    return 2 * np.pi * thickness_mm / float(q)


def _computed(elastomer: Elastomer, pitch_mm: float) -> float:
    """Return the share of a relief of one pitch that a wide slab transfers.

    It is computed with the operators of the contact solver. The pressure is a single mode of the
    slab's sine series, so both faces deflect in the same shape. Along y the mode is half a wave of
    a long wavelength. The wavenumber along x is reduced, so that the total wavenumber is that of
    the pitch.
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


def ridge_height_mm(specimen: Specimen) -> float:
    """Return the height of a specimen's ridges, mm; that of a fingerprint if it has no ridges."""
    height_mm = specimen.ridge_height_mm
    return RIDGE_MM if height_mm is None else height_mm


def ridge_transfer(
    elastomer: Elastomer, pressure_kpa: float, ridge_mm: float = RIDGE_MM
) -> ContactTransfer:
    """Return the share of the ridge height on the coated face, for pitches of 1 to 30 thicknesses.

    Parameters
    ----------
    elastomer : a sheet or slab in the opposite-face layout; its film is neglected
    pressure_kpa : pressure that presses the sheet onto the ridges; on a flat specimen this is the
        back pressure
    ridge_mm : height of the ridges, crest to root

    Returns
    -------
    `closed_form` is T(q) of a sheet that touches the whole surface of the ridges, `computed` the
    share under the given pressure

    Raises
    ------
    PressError : the pressure is not positive
    """
    if not pressure_kpa > 0:
        raise PressError(
            f"press.back_pressure_kpa: found {pressure_kpa:g}, allowed more than 0: only pressure "
            "presses a thin sheet into grooves"
        )
    thickness = elastomer.thickness_mm
    pitches = thickness * _PITCHES
    ridges = Ridges(elastomer, pressure_kpa, ridge_mm)
    return ContactTransfer(
        pitch_mm=pitches,
        closed_form=opposite_transfer(2 * np.pi * thickness / pitches),
        computed=np.array([ridges.shown(float(pitch)) for pitch in pitches]),
        half_pitch_mm=ridges.pitch_mm(0.5),
        tenth_pitch_mm=ridges.pitch_mm(0.1),
        thickness_mm=thickness,
        pressure_kpa=pressure_kpa,
        ridge_mm=ridge_mm,
    )


@dataclass(frozen=True)
class Ridges:
    """Sinusoidal ridges of one height under an elastomer with a given mean pressure."""

    elastomer: Elastomer
    pressure_kpa: float
    height_mm: float

    def shown(self, pitch_mm: float) -> float:
        """Return coat height over ridge height, both from crest to root: a ratio of 0 to 1."""
        layer = _Period(self.elastomer, pitch_mm)
        ridge = self.height_mm * (1 - np.cos(2 * np.pi * layer.x_mm / pitch_mm)) / 2
        pressure = _pressure(layer, ridge, self.pressure_kpa / layer.modulus_kpa)
        return layer.coat_mm(pressure) / self.height_mm

    def pitch_mm(self, share: float) -> float:
        """Return the pitch, mm, at which the coat has the fraction `share` of the ridge height."""
        low, high = (np.log(self.elastomer.thickness_mm * end) for end in _RANGE)
        log_pitch = brentq(lambda log: self.shown(np.exp(log)) - share, low, high, xtol=1e-4)
        return float(np.exp(log_pitch))


class _Period:
    """Half a period of the elastic layer from crest to root of a ridge, symmetric about both."""

    def __init__(self, elastomer: Elastomer, pitch_mm: float) -> None:
        self.modulus_kpa = young_modulus(elastomer).best_kpa
        self.x_mm = (np.arange(_CELLS) + 0.5) * pitch_mm / 2 / _CELLS
        wave = np.arange(1.0, _CELLS) * (2 * np.pi / pitch_mm)
        nu = elastomer.poisson_ratio
        transfer = solve_transfer(wave * elastomer.thickness_mm, nu, "free")
        unit = 2 * (1 - nu**2) / wave
        self._touched, self._coated = unit * transfer.normal_t, unit * transfer.normal_b

    def compliance(self) -> FloatArray:
        """Return the touched face's deflection (col, loaded col), mm, per pressure over modulus."""
        waves = fft.dct(np.eye(_CELLS), type=2, axis=0) * np.append(0.0, self._touched)[:, None]
        response: FloatArray = fft.idct(waves, type=2, axis=0)
        return (response + response.T) / 2

    def coat_mm(self, pressure: FloatArray) -> float:
        """Return the coated face's relief, crest to root, mm, for (col,) pressure over modulus."""
        waves = fft.dct(pressure, type=2)[1:] / _CELLS * self._coated
        return float(2 * waves[::2].sum())


def _pressure(layer: _Period, ridge_mm: FloatArray, mean: float) -> FloatArray:
    """Return the contact pressure over modulus (col,), 0 or more, with a given mean.

    It minimises the energy p (A p / 2 + S), with A the compliance and S the ridge's height. A stiff
    spring on the mean replaces the constraint. The problem is then one of nonnegative least
    squares; its active-set method terminates for every pitch.
    """
    compliance = layer.compliance()
    spring = _STIFF * float(compliance.max())
    factor = np.linalg.cholesky(compliance + spring)
    pulled = spring * mean * _CELLS - ridge_mm
    pressure, _ = nnls(factor.T, solve_triangular(factor, pulled, lower=True))
    return np.asarray(pressure * (mean / pressure.mean()))

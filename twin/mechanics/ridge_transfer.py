"""What the coat of a thin sheet shows of ridges that contact pressure presses it onto.

A slab 3 mm thick lies on all of a shallow groove, and thickness decides what its far face shows. A
thin sheet stands on the crests and sinks between them as far as pressure bends it: hardness and
pressure decide too, until it lies on the whole ridge and keeps the slab's T(q) of it.

The sheet is one period of the exact elastic layer, shear through its thickness included, which the
thin-sheet press leaves out: of a pitch of 2 thicknesses that shows only half as much. Ridges
are cosines (y constant, x across). Left out is the tension of a sheet that is stretched over the
specimen: it shows less then.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, nnls

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer
from twin.config.specimens import Fingerprint, Grating, Specimen
from twin.mechanics.contact_transfer import ContactTransfer, positive_pitches
from twin.mechanics.errors import PressError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.transfer import opposite_transfer, solve_transfer

#: of a fingerprint, the finest relief that the paper names
RIDGE_MM = 0.07
_CELLS = 128  # of half a pitch
_PITCHES = np.geomspace(1.0, 30.0, 31)  # over the thickness
_RANGE = 0.2, 200.0
_STIFF = 1e4


def ridge_height_mm(specimen: Specimen) -> float:
    """Return the height of a specimen's ridges, or that of a fingerprint's where it has none."""
    if isinstance(specimen, Grating):
        return specimen.groove_mm
    return specimen.depth_mm if isinstance(specimen, Fingerprint) else RIDGE_MM


def ridge_transfer(
    elastomer: Elastomer,
    pressure_kpa: float,
    ridge_mm: float = RIDGE_MM,
    pitches_mm: FloatArray | None = None,
) -> ContactTransfer:
    """Return what the coated face shows of ridges of each pitch.

    Parameters
    ----------
    elastomer : Elastomer
        A sheet or slab in the opposite-face layout; a film of its own is left out.
    pressure_kpa : float, kPa
        That presses the sheet onto the ridges: on a flat specimen the back pressure.
    ridge_mm : float, mm
        Crest to root.
    pitches_mm : (n,) float, mm, optional
        Pitches; by default 1 to 30 thicknesses.

    Returns
    -------
    ContactTransfer
        `closed_form` is the T(q) of a sheet that lies on all of the ridge, `computed` what shows.

    Raises
    ------
    PressError
        No pressure, a ridge without height, or a pitch that is not positive.
    """
    if not pressure_kpa > 0:
        raise PressError(
            f"press.back_pressure_kpa: found {pressure_kpa:g}, allowed more than 0: nothing else "
            "presses a thin sheet into grooves"
        )
    thickness = elastomer.thickness_mm
    pitches = positive_pitches(thickness * _PITCHES if pitches_mm is None else pitches_mm)
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
    """Ridges of one height under one pressure, of any pitch."""

    elastomer: Elastomer
    pressure_kpa: float
    height_mm: float

    def shown(self, pitch_mm: float) -> float:
        """Return the coat's relief over the ridge's, crest to root, 0 to 1."""
        layer = _Period(self.elastomer, pitch_mm)
        ridge = self.height_mm * (1 - np.cos(2 * np.pi * layer.x_mm / pitch_mm)) / 2
        pressure = _pressure(layer, ridge, self.pressure_kpa / layer.modulus_kpa)
        return layer.coat_mm(pressure) / self.height_mm

    def pitch_mm(self, share: float) -> float:
        """Return the pitch of which the coat shows a share."""
        low, high = (np.log(self.elastomer.thickness_mm * end) for end in _RANGE)
        found = brentq(lambda log: self.shown(np.exp(log)) - share, low, high, xtol=1e-4)
        return float(np.exp(found))


class _Period:
    """Half a period of the elastic layer, from crest to root, symmetric at both."""

    def __init__(self, elastomer: Elastomer, pitch_mm: float) -> None:
        self.modulus_kpa = young_modulus(elastomer).best_kpa
        self.x_mm = (np.arange(_CELLS) + 0.5) * pitch_mm / 2 / _CELLS
        wave = np.arange(1.0, _CELLS) * (2 * np.pi / pitch_mm)
        nu = elastomer.poisson_ratio
        found = solve_transfer(wave * elastomer.thickness_mm, nu, "free")
        unit = 2 * (1 - nu**2) / wave
        self._touched, self._coated = unit * found.normal_t, unit * found.normal_b

    def compliance(self) -> FloatArray:
        """Return the touched face's deflection (col, col), mm, per cell's pressure over modulus."""
        waves = fft.dct(np.eye(_CELLS), type=2, axis=0) * np.append(0.0, self._touched)[:, None]
        answer: FloatArray = fft.idct(waves, type=2, axis=0)
        return (answer + answer.T) / 2

    def coat_mm(self, pressure: FloatArray) -> float:
        """Return the coated face's relief from crest to root under (col,) pressure over modulus."""
        waves = fft.dct(pressure, type=2)[1:] / _CELLS * self._coated
        return float(2 * waves[::2].sum())


def _pressure(layer: _Period, ridge_mm: FloatArray, mean: float) -> FloatArray:
    """Return the contact pressure over modulus (col,), 0 or more, of a given mean.

    Least energy p (A p / 2 + S), a stiff spring on the mean in place of the constraint, as
    nonnegative least squares: an active set, which ends for every pitch.
    """
    compliance = layer.compliance()
    spring = _STIFF * float(compliance.max())
    factor = np.linalg.cholesky(compliance + spring)
    pulled = spring * mean * _CELLS - ridge_mm
    found, _ = nnls(factor.T, solve_triangular(factor, pulled, lower=True))
    pressure: FloatArray = found * (mean / found.mean())
    return pressure

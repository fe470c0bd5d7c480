"""Specimen kind `random_relief`: a plate whose upper face is a random rough surface.

The face is a self-affine surface: its power spectral density falls with the wavenumber q as
q^(-2 (1 + H)), H the Hurst exponent, between the wavelengths `longest_mm` and `shortest_mm`, and is
0 outside (Persson et al., J. Phys.: Condens. Matter 17, R1 (2005), section 2). It is a sum of plane
waves with these amplitudes and random phases, periodic over the side of the plate. The amplitudes
are not random: RMS and periodogram of each surface are exactly those of the keys, and the heights
are nearly normal if many waves are within the band.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from reconstruction.arrays import FloatArray
from twin.config.bounds import Length, Size
from twin.config.digest import keyed_sequence
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import height_grid_body

# The facets of the face are rendered flat for shadows: their slope must follow that of the waves.
_NODES_PER_WAVE = 12
_MOST_NODES = 1024


@SPECIMENS.register
class RandomRelief(Specimen):
    """A square plate with a random self-affine face."""

    kind: Literal["random_relief"] = "random_relief"
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        default=0, description="of the phases; another seed gives another face of equal spectrum"
    )
    rms_um: Annotated[float, Field(gt=0, le=1e4)] = Field(
        default=50.0, description="RMS height about the mean plane"
    )
    hurst: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.8, description="Hurst exponent H: the spectrum falls as q^(-2 (1 + H))"
    )
    longest_mm: Length = Field(default=5.0, description="longest wavelength of the face")
    shortest_mm: Length = Field(default=0.5, description="shortest wavelength of the face")
    length_mm: Length = Field(default=12.0, description="side of the square, period of the face")
    base_mm: Size = Field(default=2.0, description="thickness below the lowest height")

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("rms_um",)

    @model_validator(mode="after")
    def _band_fits(self) -> "RandomRelief":
        if not self.shortest_mm < self.longest_mm <= self.length_mm:
            raise ValueError(
                f"shortest_mm, longest_mm: found {self.shortest_mm:g} and {self.longest_mm:g}, "
                f"allowed rising, up to length_mm = {self.length_mm:g}"
            )
        if self.nodes > _MOST_NODES:
            raise ValueError(
                f"shortest_mm: found {self.shortest_mm:g}, allowed at least "
                f"{_NODES_PER_WAVE * self.length_mm / _MOST_NODES:g} with length_mm = "
                f"{self.length_mm:g}: the face then has {_MOST_NODES} nodes along a side"
            )
        if not self._amplitudes().any():
            raise ValueError(
                "longest_mm, shortest_mm: no wave of the period length_mm is between them; "
                "choose a wider band"
            )
        return self

    @property
    def nodes(self) -> int:
        """Number of nodes along one period of the face: twelve per shortest wavelength."""
        return int(np.ceil(_NODES_PER_WAVE * self.length_mm / self.shortest_mm))

    def heights_mm(self) -> FloatArray:
        """Return one period of the face about its mean plane, mm, (row, col), rows along +y."""
        count = self.nodes
        rng = np.random.default_rng(keyed_sequence(self.seed, "random_relief"))
        # The phases of a real random field are odd: phase(-q) = -phase(q).
        phases = np.angle(np.fft.fft2(rng.standard_normal((count, count))))
        waves = np.fft.ifft2(self._amplitudes() * np.exp(1j * phases)).real
        rms = np.sqrt(np.mean(waves**2))
        return np.asarray(waves * (1e-3 * self.rms_um / rms))

    def _amplitudes(self) -> FloatArray:
        """Return the relative amplitude of each wave, (row, col), in the order of `fft2`."""
        per_mm = np.fft.fftfreq(self.nodes, self.length_mm / self.nodes)
        wavenumber = np.hypot(per_mm[:, None], per_mm[None, :])
        within = (wavenumber * self.longest_mm >= 1) & (wavenumber * self.shortest_mm <= 1)
        safe = np.where(within, wavenumber, 1.0)
        return np.asarray(np.where(within, safe ** -(1.0 + self.hurst), 0.0))

    def shape(self) -> MeshShape:
        """Return the plate, centred on x = y = 0, with the mean plane of its face at z = 0."""
        z = np.pad(self.heights_mm(), ((0, 1), (0, 1)), mode="wrap")
        along = np.linspace(-self.length_mm / 2, self.length_mm / 2, self.nodes + 1)
        return MeshShape(height_grid_body(along, along, z, float(z.min()) - self.base_mm))

    @property
    def finest_pitch_mm(self) -> float:
        """Shortest wavelength of the face."""
        return self.shortest_mm

    @property
    def ridge_height_mm(self) -> float:
        """Height from root to crest of a sinusoid with the RMS height of the face."""
        return 2.0 * float(np.sqrt(2.0)) * 1e-3 * self.rms_um

"""An integration scheme as a plug-in: the projection of Frankot and Chellappa.

IEEE Trans. Pattern Anal. Mach. Intell. 10, 439 (1988); it takes the surface for periodic.
"""

import numpy as np

from reconstruction.integration_schemes import SCHEMES, IntegrationScheme


class FrankotChellappa(IntegrationScheme):
    """The integrable surface whose spectrum is nearest to that of the slopes."""

    name = "frankot_chellappa"
    title = "Frankot-Chellappa"
    summary = "projection onto Fourier modes, periodic border"

    def heights_mm(self, slopes, pitch_mm, boundary, weights):
        """Return heights (row, col) mm of mean 0; boundary and weights have no effect."""
        rows, cols = slopes.shape[1:]
        down = 2j * np.pi * np.fft.fftfreq(rows, pitch_mm)[:, None]
        right = 2j * np.pi * np.fft.fftfreq(cols, pitch_mm)
        square = np.abs(down) ** 2 + np.abs(right) ** 2
        square[0, 0] = np.inf  # the mean is free
        spectrum = np.conj(down) * np.fft.fft2(slopes[0]) + np.conj(right) * np.fft.fft2(slopes[1])
        return np.real(np.fft.ifft2(spectrum / square))


FRANKOT_CHELLAPPA = SCHEMES.register(FrankotChellappa())

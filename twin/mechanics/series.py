"""A sine series between its cells: at nodes that include the rim, exactly, finer or coarser."""

import numpy as np
from scipy import fft

from reconstruction.arrays import FloatArray
from reconstruction.cores import threads

_WORKERS = min(2, threads())


def sine_amplitudes(spectrum: FloatArray, rows: int, cols: int) -> FloatArray:
    """Return what a grid of nodes carries of a DST-II spectrum, which is changed."""
    counts = spectrum.shape
    # DST-II counts its highest mode of each axis twice.
    spectrum[-1] /= 2
    spectrum[:, -1] /= 2
    # Coarser nodes than cells cannot carry the highest modes, which the slab has filtered.
    kept = spectrum[: rows - 1, : cols - 1] / (counts[0] * counts[1])
    padded = np.zeros((rows - 1, cols - 1))
    padded[: kept.shape[0], : kept.shape[1]] = kept
    return padded


def sines_at_nodes(spectrum: FloatArray, rows: int, cols: int) -> FloatArray:
    """Evaluate a DST-II spectrum, which is changed, on nodes that include the rim."""
    inner = fft.dstn(sine_amplitudes(spectrum, rows, cols), type=1, workers=_WORKERS) / 4
    return np.pad(inner, 1)


def cosines(amplitudes: FloatArray, axis: int) -> FloatArray:
    """Evaluate sine amplitudes on nodes with cosines along `axis`, sines along the other."""
    sines = fft.dst(amplitudes, type=1, axis=1 - axis, workers=_WORKERS)
    along = tuple((1, 1) if direction == axis else (0, 0) for direction in range(2))
    across = tuple((0, 0) if direction == axis else (1, 1) for direction in range(2))
    mixed: FloatArray = fft.dct(np.pad(sines, along), type=1, axis=axis, workers=_WORKERS)
    return np.pad(mixed / 4, across)

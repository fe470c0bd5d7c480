"""Estimate properties of a rig from its captures: camera noise, projector light, coat contrast."""

from reconstruction.characterise.flat_field import Dark, dark_of, prnu_of
from reconstruction.characterise.photon_transfer import (
    NoiseSamples,
    PhotonTransfer,
    UncertainValue,
    photon_transfer,
    samples_of_pairs,
)
from reconstruction.characterise.projector_fit import FitLimits, ProjectorFit, fit_projector
from reconstruction.characterise.sparkle import Sparkle, sparkle_of

__all__ = [
    "Dark",
    "FitLimits",
    "NoiseSamples",
    "PhotonTransfer",
    "ProjectorFit",
    "Sparkle",
    "UncertainValue",
    "dark_of",
    "fit_projector",
    "photon_transfer",
    "prnu_of",
    "samples_of_pairs",
    "sparkle_of",
]

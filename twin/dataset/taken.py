"""Results of the stages of one sample, from which its quantities are computed."""

from dataclasses import dataclass

from reconstruction.arrays import FloatImage
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import Reconstruction
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.results.record import Colours, Recording


@dataclass(frozen=True, eq=False)
class TakenSample:
    """Results of the stages of one sample from which its quantities are computed.

    Attributes
    ----------
    experiment : the drawn experiment
    truth : true geometry at every camera pixel
    pressed : pressed elastomer; None if the bare specimen is imaged
    recording : frames and radiance of fringe projection; None for photometric stereo
    reconstruction : decoded frames; None if no quantity needs them
    colours : image of a photometric sensor with its decoded heights; None for fringes
    albedo : (row, col) reflectance of the surface; None if no quantity needs it
    """

    experiment: Experiment
    truth: Truth
    pressed: PressedElastomer | None = None
    recording: Recording | None = None
    reconstruction: Reconstruction | None = None
    colours: Colours | None = None
    albedo: FloatImage | None = None

    @property
    def patterns(self) -> PatternSet:
        """The projected patterns."""
        return self.fringes.capture.patterns

    @property
    def fringes(self) -> Recording:
        """Recorded fringes; TypeError for another method."""
        if self.recording is None:
            raise TypeError(f"{self.experiment.modality} takes no fringes")
        return self.recording

    @property
    def maps(self) -> Reconstruction:
        """Decoded fringes; TypeError if they were not decoded."""
        if self.reconstruction is None:
            raise TypeError("the frames were not decoded")
        return self.reconstruction

    @property
    def face(self) -> PressedElastomer:
        """The pressed elastomer; TypeError if the method has no press."""
        if self.pressed is None:
            raise TypeError(f"{self.experiment.modality} presses nothing")
        return self.pressed

    @property
    def image(self) -> Colours:
        """Image of a photometric sensor; TypeError for another method."""
        if self.colours is None:
            raise TypeError(f"{self.experiment.modality} takes no colours")
        return self.colours

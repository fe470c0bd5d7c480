"""Stress relaxation of the elastomer: table `[elastomer.relaxation]`."""

from typing import Annotated

from pydantic import Field, model_validator

from twin.config.base import Model
from twin.config.bounds import Because

RelaxingShare = Annotated[
    float, Field(gt=0, lt=1), Because("a gel that relaxes by all of its modulus flows")
]
RelaxationTime = Annotated[
    float,
    Field(ge=1e-6, le=1e8),
    Because("1 us, shorter than any press, to three years, longer than any hold"),
]
MOST_TERMS = 20


class Relaxation(Model):
    """Prony series of Young's modulus: E(t) / E(0) = 1 - sum of g (1 - exp(-t / tau)).

    E(0) is the modulus at once after a step: `young_modulus_kpa`, or the modulus that follows from
    the hardness. Poisson's ratio does not relax. Each share g belongs to the time tau at the same
    place of the other list.
    """

    shares: tuple[RelaxingShare, ...] = Field(
        min_length=1,
        max_length=MOST_TERMS,
        description="g: share of the initial modulus that relaxes; their sum is less than 1",
    )
    times_s: tuple[RelaxationTime, ...] = Field(
        min_length=1, max_length=MOST_TERMS, description="tau: relaxation time of each share, s"
    )

    @model_validator(mode="after")
    def _terms_are_complete(self) -> "Relaxation":
        if len(self.shares) != len(self.times_s):
            raise ValueError(
                f"shares: found {len(self.shares)} numbers and {len(self.times_s)} times_s, "
                "allowed as many of one as of the other"
            )
        if sum(self.shares) >= 1:
            raise ValueError(
                f"shares: found a sum of {sum(self.shares):.4g}, allowed less than 1: the rest is "
                "the modulus after a long time"
            )
        return self

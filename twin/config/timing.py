"""Table [timing]: when the frames of a sequence are exposed, beyond the rates of the devices.

`twin.optics.frame_times` computes the time of every frame from this table, the exposure of the
camera and the largest rates of camera and projector.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.base import Model
from twin.config.bounds import Because, Rate


class Timing(Model):
    """Rate of the patterns, delay of the exposure and readout of the image sensor."""

    pattern_rate_hz: Rate | None = Field(
        default=None,
        description="rate of the frames; absent: the largest that exposure, delay, readout, "
        "camera.frame_rate_hz and projector.pattern_rate_8bit_hz allow",
    )
    binary_rate_hz: Rate | None = Field(
        default=None,
        description="rate of frames of the levels 0 and 255 only (Gray, white, black); absent: as "
        "pattern_rate_hz, or the largest allowed one (projector.pattern_rate_1bit_hz)",
    )
    trigger_delay_ms: Annotated[
        float, Field(ge=0, le=1e3), Because("a delay of 1 s is no trigger")
    ] = Field(default=0.0, description="from the start of a pattern to that of the exposure")
    readout: Literal["global", "rolling"] = Field(
        default="global",
        description="global: all rows are exposed at the same time; rolling: each row starts "
        "line_time_us after the row above it",
    )
    line_time_us: Annotated[
        float, Field(ge=0, le=1e4), Because("10 ms per row is slower than any image sensor")
    ] = Field(default=0.0, description="readout = 'rolling': time of one row of the sensor")

    origin: Literal["sequence", "phase"] = Field(
        default="sequence",
        exclude_if=lambda origin: origin == "sequence",
        description="time 0, of the pose and of the truth: middle of all frames, or of the phase "
        "frames, where a decoded phase belongs",
    )

    @model_validator(mode="after")
    def _rolling_has_a_line_time(self) -> "Timing":
        if (self.readout == "rolling") != (self.line_time_us > 0.0):
            raise ValueError(
                f"line_time_us: found {self.line_time_us:g} with readout = '{self.readout}', "
                "allowed above 0 with 'rolling' and 0 with 'global'; change one of both"
            )
        return self

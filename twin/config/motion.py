"""Table [motion]: rigid motion of the specimen relative to camera and projector during a sequence.

The pose of the experiment is that in the middle of the sequence, time 0. Translation and rotation
are uniform. A point with the position p at time 0 is at time t at

    R_z(twist_deg_s t) R_y(roll_deg_s t) p + v t + a (sin(2 pi f t + phase) - sin(phase)) e

with the world axes z and y through the world origin, the velocity v, and amplitude a, frequency f
and direction e of the vibration. A bare specimen carries its stage with it, as on a translation
stage; motion of the sensor in the opposite direction is the same.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from reconstruction.arrays import FloatArray
from twin.config.base import Angle, Model
from twin.config.bounds import Because, Rate

Velocity = Annotated[
    float, Field(ge=-1e4, le=1e4), Because("10 m/s crosses the field of any sensor within a frame")
]
Turning = Annotated[
    float, Field(ge=-3.6e5, le=3.6e5), Because("1000 turns per second exceed any spindle")
]
_AXES = {"x": 0, "y": 1, "z": 2}


class Vibration(Model):
    """Harmonic vibration of the specimen along one axis."""

    amplitude_um: Annotated[
        float, Field(ge=0, le=1e5), Because("100 mm is more than the field of any sensor")
    ] = Field(default=0.0, description="largest displacement from the middle; 0: no vibration")
    frequency_hz: Rate = Field(default=50.0, description="of the vibration")
    direction: Literal["x", "y", "z"] = Field(default="z", description="world axis")
    phase_deg: Angle = Field(default=0.0, description="phase in the middle of the sequence")

    def displacement_mm(self, time_s: float) -> FloatArray:
        """Return the displacement (xyz), mm, at a time relative to that at time 0."""
        phase = np.deg2rad(self.phase_deg)
        swing = np.sin(2.0 * np.pi * self.frequency_hz * time_s + phase) - np.sin(phase)
        shift_mm = np.zeros(3)
        shift_mm[_AXES[self.direction]] = 1e-3 * self.amplitude_um * swing
        return shift_mm


class Motion(Model):
    """Velocity, rotation and vibration of the specimen relative to the sensor."""

    x_mm_s: Velocity = Field(default=0.0, description="velocity along world x")
    y_mm_s: Velocity = Field(default=0.0, description="velocity along world y")
    z_mm_s: Velocity = Field(
        default=0.0, description="velocity towards the camera; of a press: its rate"
    )
    twist_deg_s: Turning = Field(default=0.0, description="rotation about the world z axis")
    roll_deg_s: Turning = Field(
        default=0.0, description="rotation about the world y axis, of a bare specimen"
    )
    vibration: Vibration = Field(default=Vibration(), description="absent: no vibration")
    time_s: Annotated[float, Field(ge=-1e4, le=1e4)] | None = Field(
        default=None,
        exclude_if=lambda time_s: time_s is None,
        description="the scene at rest at this time after the middle of the sequence; absent: the "
        "scene moves",
    )

    encoder: bool = Field(
        default=False,
        exclude_if=lambda encoder: not encoder,
        description="the capture contains the positions of the stage, and the frames are corrected"
        " by them; of a bare specimen that does not turn",
    )
    encoder_surface_z_mm: Annotated[float, Field(ge=-1e3, le=1e3)] = Field(
        default=0.0,
        exclude_if=lambda z_mm: z_mm == 0.0,
        description="world z of the nominal surface for this correction",
    )

    @property
    def is_stated(self) -> bool:
        """Whether any velocity, rotation or vibration differs from 0."""
        rates = (self.x_mm_s, self.y_mm_s, self.z_mm_s, self.twist_deg_s, self.roll_deg_s)
        return any(rates) or self.vibration.amplitude_um > 0.0

    @property
    def moves(self) -> bool:
        """Whether the scene moves during the sequence."""
        return self.is_stated and self.time_s is None

    @property
    def only_vibrates(self) -> bool:
        """Whether a vibration is the only motion."""
        rates = (self.x_mm_s, self.y_mm_s, self.z_mm_s, self.twist_deg_s, self.roll_deg_s)
        return self.vibration.amplitude_um > 0.0 and not any(rates)

    def velocity_mm_s(self) -> FloatArray:
        """Return the uniform velocity (xyz), mm/s."""
        return np.array([self.x_mm_s, self.y_mm_s, self.z_mm_s])

    def shift_mm(self, time_s: float) -> FloatArray:
        """Return the displacement (xyz), mm, of a point on both axes since time 0."""
        return self.velocity_mm_s() * time_s + self.vibration.displacement_mm(time_s)

    def pose_at(self, time_s: float) -> FloatArray:
        """Return the displacement since time 0 as T_world_from_rest (4, 4), mm."""
        twist, roll = np.deg2rad([self.twist_deg_s * time_s, self.roll_deg_s * time_s])
        c, s = np.cos(twist), np.sin(twist)
        twisted = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        c, s = np.cos(roll), np.sin(roll)
        pose = np.eye(4)
        pose[:3, :3] = twisted @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        pose[:3, 3] = self.shift_mm(time_s)
        return pose

    @property
    def pose(self) -> FloatArray:
        """Displacement of the scene at rest at `time_s`; the identity without a time."""
        return np.eye(4) if self.time_s is None else self.pose_at(self.time_s)

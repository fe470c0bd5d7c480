"""Calibration board as data: the printed pattern, its plate, and the poses of the board.

Poses are in the world frame (z up towards the devices). At zero tilt and shift, the face of the
board is z = 0 and its rows are along world x.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from reconstruction.calibration.boards import Board, CharucoBoard, Chessboard, DotBoard
from twin.assets import scene_file
from twin.config.base import Angle, Fraction, Model
from twin.config.bounds import Length
from twin.config.loading import read_toml
from twin.config.models import Provenance
from twin.config.quantities import check_ranges, convert_units, split_quantities
from twin.config.schema import validated

Count = Annotated[int, Field(ge=2, le=1000)]
Shift = Annotated[float, Field(ge=-1000, le=1000)]


class Dots(Model):
    """Pattern of dark dots on a square grid, three of them larger; see `DotBoard`."""

    kind: Literal["dots"] = "dots"
    columns: Count
    rows: Count
    pitch_mm: Length
    dot_diameter_mm: Length
    fiducial_diameter_mm: Length

    def board(self) -> DotBoard:
        """Return the pattern in the form that the feature detector takes."""
        return DotBoard(
            self.columns, self.rows, self.pitch_mm, self.dot_diameter_mm, self.fiducial_diameter_mm
        )


class Chess(Model):
    """Chessboard pattern; columns and rows are the numbers of its INNER corners."""

    kind: Literal["chessboard"] = "chessboard"
    columns: Count
    rows: Count
    square_mm: Length

    def board(self) -> Chessboard:
        """Return the pattern in the form that the feature detector takes."""
        return Chessboard(self.columns, self.rows, self.square_mm)


class Charuco(Model):
    """ChArUco pattern with OpenCV's 4 x 4 markers; columns and rows count the INNER corners."""

    kind: Literal["charuco"] = "charuco"
    columns: Count
    rows: Count
    square_mm: Length
    marker_mm: Length

    def board(self) -> CharucoBoard:
        """Return the pattern in the form that the feature detector takes."""
        return CharucoBoard(self.columns, self.rows, self.square_mm, self.marker_mm)


class BoardPlate(Model):
    """Plate with the printed pattern; its face is matte (Lambertian)."""

    width_mm: Length
    height_mm: Length
    white_albedo: Fraction
    ink_albedo: Fraction


class BoardPose(Model):
    """Pose of the board in the world frame."""

    tilt_deg: Annotated[float, Field(ge=0, le=60)] = Field(
        default=0.0, description="angle between the board's normal and world z"
    )
    azimuth_deg: Angle = Field(
        default=0.0, description="direction in the world xy plane to which the normal leans"
    )
    spin_deg: Angle = Field(default=0.0, description="turn in the board's own plane")
    x_mm: Shift = 0.0
    y_mm: Shift = 0.0
    z_mm: Shift = 0.0


class BoardFile(Model):
    """Content of a board file: pattern, plate, and poses for a rendered calibration."""

    description: str = ""
    pattern: Annotated[Dots | Chess | Charuco, Field(discriminator="kind")]
    plate: BoardPlate
    poses: tuple[BoardPose, ...] = Field(
        default=(), description="of a rendered calibration; the first is the world frame"
    )
    provenance: dict[str, Provenance] = Field(default_factory=dict)

    def board(self) -> Board:
        """Return the pattern in the form that the feature detector takes."""
        return self.pattern.board()


def load_board(name: str | Path) -> BoardFile:
    """Load a board from a file, or a shipped board by its name ("boards/paper_dots").

    Raises
    ------
    ConfigError : one line per problem: key, found, allowed, remedy
    AssetError : there is no such file and no such shipped board
    """
    file = scene_file(name)
    values, origins = split_quantities(convert_units(read_toml(file)))
    values["provenance"] = {key: origin.model_dump() for key, origin in origins.items()}
    loaded = validated(BoardFile, values, f"{file}: ")
    check_ranges(values, loaded.provenance, str(file))
    loaded.board()  # checks the pattern, for example that dots do not touch
    return loaded

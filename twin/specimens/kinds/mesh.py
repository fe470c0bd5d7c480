"""Specimen kind `mesh`: a triangle mesh from a file."""

from typing import Literal

import numpy as np
from pydantic import Field

from twin.config.bounds import FileUnit
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.mesh_files import read_body_mm
from twin.specimens.meshes import MeshShape

# The file of a body below this size may be in metres or inches.
_DOUBTFUL_MM = 1.0
# Rows: the file's axes that become x, y and z, for each allowed value of `up`.
_UP = {
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}


@SPECIMENS.register
class MeshFile(Specimen):
    """A closed triangle mesh from a file: STL, PLY or OBJ."""

    kind: Literal["mesh"] = "mesh"
    file: str = Field(description="path, or the name of a shipped mesh such as scenes/meshes/x.stl")
    scale: FileUnit = Field(
        default=1.0, description="mm per unit of the file: 1000 for metres, 25.4 for inches"
    )
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(
        default="+z", description="axis of the file that faces the elastomer"
    )

    def shape(self) -> MeshShape:
        """Return the mesh of the file with its `up` axis along +z and its bounding box centred.

        Raises
        ------
        InputError : the file is missing or no mesh, or the mesh is empty, not watertight or of
            implausible size
        """
        surface = read_body_mm("specimen.file", self.file, "specimen.scale", self.scale)
        turn = np.eye(4)
        turn[:3, :3] = _UP[self.up]
        surface.apply_transform(turn)
        surface.apply_translation(-surface.bounds.mean(axis=0))
        return MeshShape(surface)

    def warnings(self) -> tuple[str, ...]:
        """Return a warning if the size of the mesh suggests a file in metres or inches."""
        size_mm = float(self.shape().body.extents.max())
        if size_mm >= _DOUBTFUL_MM:
            return ()
        return (
            f"the longest side of {self.file} is {size_mm:.2g} mm at specimen.scale = "
            f"{self.scale:g}: if the file is in metres, set specimen.scale = 1000; in inches, 25.4",
        )

"""The `fem` model: tetrahedra, for slabs on other supports and for pads from CAD.

See `twin.mechanics.reference`. scikit-fem and the mesher are imported at the first check or press.
"""

from typing import TYPE_CHECKING

from reconstruction.arrays import FloatArray
from twin.config.models import Elastomer, Mechanics, PadFile
from twin.mechanics.errors import PressError
from twin.mechanics.models import (
    MODELS,
    ElastomerModel,
    PressInput,
    Progress,
    refuse_sheet_keys,
)
from twin.mechanics.press import PressedElastomer
from twin.specimens.mesh_files import read_body_mm

if TYPE_CHECKING:
    from twin.mechanics.reference.pad import Pad


class FemModel(ElastomerModel):
    """Linear elastic tetrahedra: a slab on any support, or a pad of any shape."""

    name = "fem"
    summary = (
        "other supports and pads from CAD (its mesher, and so its last digits, differ from run to "
        "run)"
    )
    takes = ("support", "pad")
    refuses_sheet_keys = False  # the keys of a sheet do not describe a pad from CAD

    def check(self, case: PressInput) -> None:
        """Raise an error for a film, a thickness field, an unsuitable support or a faulty pad."""
        from twin.mechanics.reference.fem import check_fem

        check_fem(case.elastomer, case.mechanics.support)
        if case.elastomer.thickness_field is not None:
            refuse_sheet_keys(case.elastomer, self.name, ["thickness_field"])
        _pad(case.mechanics, case.elastomer)

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the pressed elastomer, computed by finite elements of a slab or pad."""
        from twin.mechanics.reference.fem import press_fem

        return press_fem(
            case.specimen,
            case.elastomer,
            case.load,
            support=case.mechanics.support,
            ledge_mm=case.mechanics.ledge_mm,
            pad=_pad(case.mechanics, case.elastomer),
            count=case.mechanics.tetrahedra,
        )

    def rest_face_mm(
        self, case: PressInput, x_mm: FloatArray, y_mm: FloatArray
    ) -> FloatArray | None:
        """Return world z (row, col), mm, of the pad's undeformed coated face; None for a slab."""
        from twin.mechanics.reference.pad import rest_mm

        pad = _pad(case.mechanics, case.elastomer)
        return None if pad is None else rest_mm(pad, x_mm, y_mm)


def _pad(mechanics: Mechanics, elastomer: Elastomer) -> "Pad | None":
    return None if mechanics.pad is None else read_pad(mechanics.pad, elastomer)


def read_pad(source: PadFile, elastomer: Elastomer) -> "Pad":
    """Read a pad from CAD, move it into the world frame and select its faces.

    Raises
    ------
    InputError : the file is missing, unreadable or not closed, the layout does not fit, or the
        elastomer's rectangle reaches beyond the pad's coated face
    """
    from twin.mechanics.reference.pad import Hold, Pad, check_cover, facing, on_plane

    _check_layout(elastomer)
    scale = "mechanics.pad.scale_mm"
    body = read_body_mm("mechanics.pad.file", source.file, scale, source.scale_mm)
    low, high = body.bounds
    body.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    coated = facing((0, 0, -1), source.facing_deg)
    window = on_plane("z", float(body.bounds[1, 2]))
    check_cover(body, coated, elastomer)
    return Pad(
        body,
        elastomer.poisson_ratio,
        (Hold(window),),
        touched=coated,
        coated=coated,
        is_designed=True,
    )


def _check_layout(elastomer: Elastomer) -> None:
    if elastomer.layout != "contact_face":
        raise PressError(
            "mechanics.pad: needs elastomer.layout = 'contact_face' (it is seen through its window)"
        )


FEM = MODELS.register(FemModel())

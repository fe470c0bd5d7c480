"""An elastomer model as a plug-in: a Winkler bed, independent springs on a rigid window.

Pressure is the foundation's stiffness x penetration. By default the stiffness is
E (1 - nu) / ((1 + nu) (1 - 2 nu) h), as of a bonded layer that is much thinner than its contact is
wide (Johnson, Contact Mechanics, section 5.8). The table [mechanics.settings.winkler] sets another.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from twin.config.base import Model
from twin.config.models import Elastomer
from twin.mechanics import PressedElastomer, PressError, young_modulus
from twin.mechanics.layouts import cell_centres, face_nodes
from twin.mechanics.models import MODELS, ElastomerModel, PressInput, Progress
from twin.mechanics.validity import contact_validity


class Foundation(Model):
    """Settings of the model, the table [mechanics.settings.winkler]."""

    stiffness_kpa_per_mm: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        default=None, description="of the springs; absent: that of a thin bonded layer"
    )


class Winkler(ElastomerModel):
    """Springs between coat and window; the coat has the specimen's shape where it touches."""

    name = "winkler"
    settings = Foundation
    summary = "independent springs on a window, pressed to a depth"
    leaves_out = "the springs' coupling"

    def check(self, case: PressInput) -> None:
        """Raise PressError for another layout or control, film, air pressure or weight."""
        super().check(case)
        elastomer, load = case.elastomer, case.load
        loaded = elastomer.film or load.back_pressure_kpa or load.gravity_deg is not None
        if loaded or load.depth_mm is None or elastomer.layout != "contact_face":
            raise PressError(
                "mechanics.model: found 'winkler', which needs elastomer.layout = 'contact_face' "
                "and press.control = 'depth', without film, back pressure and weight"
            )

    def press(self, case: PressInput, progress: Progress | None = None) -> PressedElastomer:
        """Return the press in closed form."""
        elastomer, load, depth_mm = case.elastomer, case.load, case.load.depth_mm or 0.0
        lengths = elastomer.length_x_mm, elastomer.length_y_mm
        x, y = (cell_centres(length, load) for length in lengths)
        face_x, face_y = (face_nodes(length, load) for length in lengths)
        touched, coat = (
            np.maximum(depth_mm - case.shape.height_above_lowest(*at), 0.0)
            for at in ((x, y), (face_x, face_y))
        )
        given = case.settings(self.name, Foundation).stiffness_kpa_per_mm
        stiffness = given or bonded_layer_stiffness(elastomer)
        pressure, contact = stiffness * touched, touched > 0
        return PressedElastomer(
            *(x, y, pressure, contact, touched),
            force_n=1e-3 * float(pressure.sum() * (x[1] - x[0]) * (y[1] - y[0])),
            depth_mm=depth_mm,
            young_modulus_kpa=young_modulus(elastomer).best_kpa,
            face_x_mm=face_x,
            face_y_mm=face_y,
            face_z_mm=coat,
            validity=contact_validity(case.shape, elastomer, (x, y, contact), depth_mm, depth_mm),
            iterations=1,
            converged=True,
        )


def bonded_layer_stiffness(elastomer: Elastomer) -> float:
    """Return the stiffness of a thin layer between rigid faces, kPa/mm."""
    modulus_kpa, nu = young_modulus(elastomer).best_kpa, elastomer.poisson_ratio
    return modulus_kpa * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / elastomer.thickness_mm


WINKLER = MODELS.register(Winkler())

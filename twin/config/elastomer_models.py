"""Registry of the elastomer models: allowed values of `mechanics.model` with their keys.

A model is an instance of a subclass of `twin.mechanics.models.ElastomerModel`. It is defined in
one file of `twin.mechanics.models`, of an installed package (entry points of the group
`fringe_twin.elastomer_models`) or of the user (`--plugin`). The properties with which experiments
are checked are declared here, because experiment files are read without loading a solver.
"""

from typing import ClassVar

from reconstruction.registry import Registry


class ModelFields:
    """Properties of an elastomer model that are available without loading its solver."""

    name: ClassVar[str] = ""
    """Value of `mechanics.model` that selects the model."""

    summary: ClassVar[str] = ""
    """One line for the list of keys: the effects that the model includes, and its validity."""

    takes: ClassVar[tuple[str, ...]] = ()
    """Optional keys of `[mechanics]` that the model takes: `support`, `pad`."""

    is_automatic: ClassVar[bool] = False
    """Whether `mechanics.model = "auto"` may select the model, which must then state its error."""


MODELS: Registry[ModelFields] = Registry(
    "elastomer_models", "twin.mechanics.models", lambda model: model.name
)
"""Registry of the elastomer models."""

AUTO = "auto"
"""Value of `mechanics.model` that selects the model with the least stated error."""


def models_that_take(key: str, model: str) -> tuple[str, ...]:
    """Return the names of the models that take a key of `[mechanics]`.

    Empty if the given `model` takes the key.

    `auto` takes the keys of each model that it may select.
    """
    takers = [kind for kind in MODELS if key in kind.takes]
    if any(kind.name == model or (model == AUTO and kind.is_automatic) for kind in takers):
        return ()
    return tuple(kind.name for kind in takers)

"""Registry of the elastomer models: allowed values of `mechanics.model` with their keys.

A model is an instance of a subclass of `twin.mechanics.models.ElastomerModel`. It is defined in
one file of `twin.mechanics.models`, of an installed package (entry points of the group
`fringe_twin.elastomer_models`) or of the user (`--plugin`). The properties with which experiments
are checked are declared here, because experiment files are read without loading a solver.
"""

from typing import ClassVar

from reconstruction.registry import PluginError, Registry
from twin.config.base import Model


class ModelFields:
    """Properties of an elastomer model that are available without loading its solver."""

    name: ClassVar[str] = ""
    """Value of `mechanics.model` that selects the model."""

    summary: ClassVar[str] = ""
    """One line for the list of keys: the effects that the model includes, and its validity."""

    takes: ClassVar[tuple[str, ...]] = ()
    """Optional keys of `[mechanics]` that the model takes: `support`, `pad`."""

    settings: ClassVar[type[Model] | None] = None
    """Data model of its table `[mechanics.settings.NAME]`, each key with a default; None: no table.
    """

    is_automatic: ClassVar[bool] = False
    """Whether `mechanics.model = "auto"` may select the model, which must then state its error."""


def _name_of(model: ModelFields) -> str:
    """Return the name of a model.

    Raises
    ------
    PluginError : a key of its settings has no default
    """
    fields = {} if model.settings is None else model.settings.model_fields
    required = [key for key, field in fields.items() if field.is_required()]
    if required:
        raise PluginError(
            f"elastomer_models: {model.name}: settings: found no default of {required[0]}; add one"
        )
    return model.name


MODELS: Registry[ModelFields] = Registry("elastomer_models", "twin.mechanics.models", _name_of)
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


def settings_models() -> dict[str, type[Model]]:
    """Return the data models of the models with settings of their own, by the model's name."""
    return {model.name: model.settings for model in MODELS if model.settings is not None}


def default_settings(model: str) -> dict[str, Model]:
    """Return the default settings of a named model as table by name; empty: it has none.

    `auto` has none, so that an experiment is validated without loading the models.
    """
    settings = None if model == AUTO or model not in MODELS else MODELS[model].settings
    return {} if settings is None else {model: settings()}

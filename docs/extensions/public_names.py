"""A directive that documents the public names of a package in the order of its table `NAMES`."""

import importlib
from types import ModuleType

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class PublicNames(SphinxDirective):
    """One entry of autodoc per name; for reStructuredText, as in an `eval-rst` block."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the entries."""
        package = importlib.import_module(self.arguments[0])
        lines = [line for name in package.NAMES for line in entry(package, name)]
        return self.parse_text_to_nodes("\n".join(lines))


def entry(package: ModuleType, name: str) -> list[str]:
    """Return the directive of one name; results of methods and properties are listed, too."""
    value = getattr(package, name)
    place = f"{package.__name__}.{name}"
    if not isinstance(value, type):
        return [f".. autofunction:: {place}", ""]
    with_members = ["   :members:"] if hasattr(value, "plot") else []
    return [f".. autoclass:: {place}", *with_members, ""]


def setup(app: Sphinx) -> dict[str, bool]:
    """Enter the directive."""
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True}

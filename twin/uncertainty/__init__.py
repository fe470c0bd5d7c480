"""Uncertainty of any figure of a measurement: trials, intervals, ranked budget, sensitivities.

The trials are cases of a study (`twin.study.trials`): its store, workers, resume and cluster. Here
their results become distributions (JCGM 101) and budgets (JCGM 100).
"""

import sys
from types import ModuleType
from typing import Any


class _CallablePackage(ModuleType):
    """The package bears the name of its one public function, `twin.uncertainty(...)`.

    Python enters an imported package into the one above it, where it would hide a function of that
    name; so the package itself is called. The price is this class.
    """

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Repeat a measurement with its inputs drawn anew; see `twin.uncertainty.trials`."""
        from twin.uncertainty.trials import uncertainty

        return uncertainty(*arguments, **options)


sys.modules[__name__].__class__ = _CallablePackage

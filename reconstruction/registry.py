"""Registries: the kinds of one seam by name, each from one file that registers it.

A seam is a place where the twin can be extended: specimens, coatings, pattern codes. Its registry
takes kinds from three places:

1. the modules of its home package: a file put there is a kind;
2. installed packages: entry points of the group `fringe_twin.SEAM`, each of which names a kind;
3. plug-in files: Python files that the user names with `--plugin` (see `load_plugin`).

A data file that is read never runs code.
"""

import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from pkgutil import iter_modules
from threading import RLock
from traceback import extract_tb
from typing import Any, Generic, TypeVar

from reconstruction.errors import InputError, one_line

Kind = TypeVar("Kind")

PLUGINS_VARIABLE = "FRINGE_TWIN_PLUGINS"
"""Environment variable with the plug-in files of this process, for the processes that it starts."""


class PluginError(InputError):
    """A plug-in that cannot be loaded, or a kind that cannot be registered."""


class Registry(Generic[Kind]):
    """The kinds of one seam by name. They are loaded when the first is looked up.

    Parameters
    ----------
    seam : plural name; the entry points' group is `fringe_twin.SEAM`
    home : package whose modules register the built-in kinds
    name_of : gives a kind's name
    """

    def __init__(self, seam: str, home: str, name_of: Callable[[Kind], str]) -> None:
        self.seam, self.home, self.name_of = seam, home, name_of
        self._kinds: dict[str, Kind] = {}
        self._listeners: list[Callable[[], Any]] = []
        self._lock = RLock()
        self._is_loading = self._is_complete = False

    def register(self, kind: Kind) -> Kind:
        """Enter a kind; works as a decorator.

        Raises
        ------
        PluginError : another kind of this name is registered
        """
        name = self.name_of(kind)
        known = self._kinds.setdefault(name, kind)
        if known is not kind:
            raise PluginError(
                f"{self.seam}: found the kind '{name}' twice, in {_origin(known)} and in "
                f"{_origin(kind)}; rename one"
            )
        if self._is_complete:
            self._notify()
        return kind

    def on_change(self, listener: Callable[[], Any]) -> None:
        """Call `listener` after each kind that is registered once the built-in ones are loaded."""
        self._listeners.append(listener)

    def names(self) -> tuple[str, ...]:
        """Return the names of all kinds in alphabetical order."""
        return tuple(sorted(self._loaded()))

    def items(self) -> tuple[tuple[str, Kind], ...]:
        """Return names and kinds in alphabetical order."""
        return tuple(sorted(self._loaded().items(), key=lambda item: item[0]))

    def __iter__(self) -> Iterator[Kind]:
        return iter([kind for _, kind in self.items()])

    def __contains__(self, name: object) -> bool:
        return name in self._loaded()

    def __getitem__(self, name: str) -> Kind:
        """Return the kind of a name.

        Raises
        ------
        InputError : there is no kind of this name
        """
        kinds = self._loaded()
        if name not in kinds:
            close = get_close_matches(name, kinds, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise InputError(
                f"{self.seam}: found '{name}', allowed: {', '.join(self.names())}{hint}"
            )
        return kinds[name]

    def _loaded(self) -> dict[str, Kind]:
        with self._lock:
            # A kind that looks up others while it is registered sees those loaded so far.
            if not (self._is_complete or self._is_loading):
                self._is_loading = True
                try:
                    self._load()
                    self._is_complete = True
                finally:
                    self._is_loading = False
        return self._kinds

    def _load(self) -> None:
        home = import_module(self.home)
        for module in sorted(iter_modules(home.__path__), key=lambda module: module.name):
            import_module(f"{self.home}.{module.name}")
        for point in sorted(entry_points(group=f"fringe_twin.{self.seam}"), key=lambda p: p.name):
            self.register(_kind_at(point))
        load_inherited_plugins()

    def _notify(self) -> None:
        for listener in self._listeners:
            listener()


def load_plugin(file: str | Path) -> None:
    """Run a Python file that registers kinds, here and in the processes started from here.

    Raises
    ------
    PluginError : there is no such file, or it fails; the line names the place in the file
    """
    path = Path(file).resolve()
    _run(path)
    inherited = _inherited()
    if path not in inherited:
        os.environ[PLUGINS_VARIABLE] = os.pathsep.join(map(str, [*inherited, path]))


def load_inherited_plugins() -> None:
    """Run the plug-in files of the process that started this one."""
    for path in _inherited():
        _run(path)


def _inherited() -> list[Path]:
    return [Path(name) for name in os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep) if name]


def _run(path: Path) -> None:
    """Import a file once, under a name of its own."""
    name = f"fringe_twin_plugin_{hashlib.sha256(os.fsencode(path)).hexdigest()[:16]}"
    if name in sys.modules:
        return
    if not path.is_file():
        raise PluginError(f"--plugin {path}: found no file there; give the path of a Python file")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PluginError(f"--plugin {path}: found no Python file; its name must end with .py")
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise PluginError(f"--plugin {path}{_line_in(path, error)}: {_said(error)}") from error


def _line_in(path: Path, error: Exception) -> str:
    """Return the last line of the file that the error passed, ":LINE"; empty if none."""
    if isinstance(error, SyntaxError):
        return f":{error.lineno}"
    lines = [
        frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == str(path)
    ]
    return f":{lines[-1]}" if lines else ""


def _said(error: Exception) -> str:
    if isinstance(error, InputError):
        return one_line(error)
    return f"{type(error).__name__}: {one_line(error)}"


def _kind_at(point: EntryPoint) -> Any:
    try:
        return point.load()
    except Exception as error:
        package = point.dist.name if point.dist is not None else "an installed package"
        raise PluginError(
            f"{package}: entry point {point.group}: {point.name} = {point.value}: {_said(error)}; "
            "mend or uninstall the package"
        ) from error


def _origin(kind: object) -> str:
    return str(getattr(kind, "__module__", type(kind).__module__))

"""Registries: the kinds of one extension point by name, each from one file that registers it.

An extension point ("seam") is a part of the twin that users can extend: specimens, coatings,
pattern codes. Its registry loads kinds from three sources:

1. the modules of its home package: each file in it registers a kind;
2. installed packages: entry points of the group `fringe_twin.SEAM`, each of which names a kind;
3. plug-in files: Python files that the user names with `--plugin` (see `load_plugin`).

Reading a data file never runs code.
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
    """The kinds of one extension point by name. They are loaded at the first look-up.

    Parameters
    ----------
    seam : plural name; the entry points' group is `fringe_twin.SEAM`
    home : package whose modules register the built-in kinds
    name_of : returns the name of a kind
    """

    def __init__(self, seam: str, home: str, name_of: Callable[[Kind], str]) -> None:
        self.seam, self.home, self.name_of = seam, home, name_of
        self._kinds: dict[str, Kind] = {}
        self._listeners: list[Callable[[], Any]] = []
        self._lock = RLock()
        self._is_loading = self._is_complete = False

    def register(self, kind: Kind) -> Kind:
        """Register a kind; can be used as a decorator.

        Raises
        ------
        PluginError : another kind of this name is registered
        """
        name = self.name_of(kind)
        registered = self._kinds.setdefault(name, kind)
        if registered is not kind:
            raise PluginError(
                f"{self.seam}: found the kind '{name}' twice, in {_origin(registered)} and in "
                f"{_origin(kind)}; rename one"
            )
        if self._is_complete:
            self._notify()
        return kind

    def on_change(self, listener: Callable[[], Any]) -> None:
        """Call `listener` after each registration that follows the loading of built-in kinds."""
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
            # A kind that looks up others during its registration gets those loaded so far.
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
    """Run a Python file that registers kinds, in this process and in its child processes.

    Raises
    ------
    PluginError : there is no such file, or it fails; the message names the line in the file
    """
    path = Path(file).resolve()
    _run(path)
    inherited = plugin_files()
    if path not in inherited:
        os.environ[PLUGINS_VARIABLE] = os.pathsep.join(map(str, [*inherited, path]))


def load_inherited_plugins() -> None:
    """Run the plug-in files of the parent process."""
    for path in plugin_files():
        _run(path)


def plugin_files() -> list[Path]:
    """Return the plug-in files of this process, in the order in which they were loaded."""
    return [Path(name) for name in os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep) if name]


def _run(path: Path) -> None:
    """Import a file once, under a module name derived from its path."""
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
        raise PluginError(f"--plugin {path}{_line_in(path, error)}: {_message(error)}") from error


def _line_in(path: Path, error: Exception) -> str:
    """Return the last line of the file in the traceback, ":LINE"; empty if there is none."""
    if isinstance(error, SyntaxError):
        return f":{error.lineno}"
    lines = [
        frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == str(path)
    ]
    return f":{lines[-1]}" if lines else ""


def _message(error: Exception) -> str:
    if isinstance(error, InputError):
        return one_line(error)
    return f"{type(error).__name__}: {one_line(error)}"


def _kind_at(point: EntryPoint) -> Any:
    try:
        return point.load()
    except Exception as error:
        package = point.dist.name if point.dist is not None else "an installed package"
        raise PluginError(
            f"{package}: entry point {point.group}: {point.name} = {point.value}: "
            f"{_message(error)}; mend or uninstall the package"
        ) from error


def _origin(kind: object) -> str:
    return str(getattr(kind, "__module__", type(kind).__module__))

"""Registries, which return the kinds of an extension point by name.

An extension point ("seam") is a part of the twin that users can extend, such as specimens, coatings
or pattern codes. A kind is one variant of it, such as one pattern code. The registry of an
extension point loads kinds from three sources:

1. the modules of its home package: each module registers a kind;
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
"""Environment variable that passes the paths of the plug-in files on to child processes."""


class PluginError(InputError):
    """A plug-in that cannot be loaded, or a kind that cannot be registered."""


class Registry(Generic[Kind]):
    """The kinds of one extension point by name. The kinds are loaded at the first look-up.

    Parameters
    ----------
    seam : plural name of the extension point; its group of entry points is `fringe_twin.SEAM`
    home : name of the package in which each module registers a built-in kind
    name_of : function that returns the name of a kind
    """

    def __init__(self, seam: str, home: str, name_of: Callable[[Kind], str]) -> None:
        self.seam, self.home, self.name_of = seam, home, name_of
        self._kinds: dict[str, Kind] = {}
        self._listeners: list[Callable[[], Any]] = []
        self._lock = RLock()
        self._is_loading = self._is_complete = False

    def register(self, kind: Kind) -> Kind:
        """Register a kind and return it, so that the method can be used as a decorator.

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
        """Call `listener` at each registration after the first look-up, e.g. by a plug-in."""
        self._listeners.append(listener)

    def names(self) -> tuple[str, ...]:
        """Return the names of all kinds in alphabetical order."""
        return tuple(sorted(self._loaded()))

    def items(self) -> tuple[tuple[str, Kind], ...]:
        """Return pairs of name and kind in alphabetical order of the names."""
        return tuple(sorted(self._loaded().items(), key=lambda item: item[0]))

    def __iter__(self) -> Iterator[Kind]:
        return iter([kind for _, kind in self.items()])

    def __contains__(self, name: object) -> bool:
        return name in self._loaded()

    def __getitem__(self, name: str) -> Kind:
        """Return the kind with this name.

        Raises
        ------
        InputError : there is no kind with this name
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
    """Run a Python file that registers kinds; child processes started later run it, too.

    Raises
    ------
    PluginError : the file is missing or raises an exception; the message then names its line
    """
    path = Path(file).resolve()
    _run(path)
    inherited = plugin_files()
    if path not in inherited:
        os.environ[PLUGINS_VARIABLE] = os.pathsep.join(map(str, [*inherited, path]))


def load_inherited_plugins() -> None:
    """Run the plug-in files that the parent process has loaded."""
    for path in plugin_files():
        _run(path)


def plugin_files() -> list[Path]:
    """Return the plug-in files of this process, in the order in which they were loaded."""
    return [Path(name) for name in os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep) if name]


def _run(path: Path) -> None:
    """Import a plug-in file, at most once, under a module name derived from its path."""
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
    """Return the last line number of the file in the traceback as ":LINE"; "" if there is none."""
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

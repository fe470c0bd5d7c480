"""Single output files of commands: written atomically, and never over an existing file."""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from reconstruction.errors import InputError
from reconstruction.machine import unwritable
from reconstruction.writing import make_durable
from twin.working import remove_leftovers, working_folder


@contextmanager
def creating(path: Path) -> Iterator[Path]:
    """Yield a path to write to; at the end the file is moved to `path` in one atomic step.

    Raises
    ------
    InputError : there is such a file already, or it cannot be written
    OSError : the disk is full
    """
    _refuse_existing(path)
    with ExitStack() as stack:
        try:
            remove_leftovers(path.parent, path.name)
            folder = stack.enter_context(working_folder(path.parent, path.name))
            yield folder / path.name
            make_durable(folder)
            _refuse_existing(path)
            (folder / path.name).replace(path)
        except OSError as error:
            raise unwritable(path, error) from None


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already; give another name, or delete it")


@contextmanager
def naming_unwritable(path: Path, kind: type[InputError] = InputError) -> Iterator[None]:
    """Name `path` in the error of a block that cannot write it.

    Raises
    ------
    InputError : it cannot be written; `kind` where another one is given
    OSError : the disk is full
    """
    try:
        yield
    except OSError as error:
        raise unwritable(path, error, kind) from None

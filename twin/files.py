"""Single output files of commands: each is written atomically and replaces no existing file."""

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
    """Yield a temporary path to write to; afterwards move that file to `path` in one atomic step.

    Raises
    ------
    InputError : `path` exists already, or cannot be written
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
    """Convert an OSError of the block into an error that names `path`.

    Parameters
    ----------
    kind : class of the raised error, unless the disk is full

    Raises
    ------
    InputError : `path` cannot be written
    OSError : the disk is full
    """
    try:
        yield
    except OSError as error:
        raise unwritable(path, error, kind) from None

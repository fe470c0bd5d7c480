"""Remove the modules that Windows lacks from this process, then run a command or import all.

    python -m tests.packaging.windows import
    python -m tests.packaging.windows twin ARGUMENTS

The byte locks of `msvcrt` are imitated on those of `fcntl`: at the position of the file, without
waiting, PermissionError where another process has the byte.
"""

import importlib
import mmap
import os
import pkgutil
import shutil
import signal
import sys
import types

MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog")
NAMES = {
    os: "fork forkpty register_at_fork sched_getaffinity sysconf O_DIRECTORY O_NONBLOCK getuid "
    "geteuid killpg setsid getpgid",
    signal: "SIGHUP SIGPROF SIGALRM SIGKILL pthread_sigmask setitimer",
    mmap: "MAP_PRIVATE MAP_SHARED",
}
OPTIONAL = ("twin.viewer",)


def hide() -> None:
    """Hide modules and functions; those of Python's own library that need them are loaded first."""
    for name in ("asyncio", "multiprocessing.context", "concurrent.futures.process", "logging"):
        importlib.import_module(name)
    sys.modules["msvcrt"] = imitated()
    sys.modules |= dict.fromkeys(MODULES)  # type: ignore[arg-type]
    shutil._use_fd_functions = False
    for module, names in NAMES.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)


def imitated() -> types.ModuleType:
    """Return a `msvcrt` with locks."""
    import fcntl

    made = types.ModuleType("msvcrt")
    made.LK_UNLCK, made.LK_NBLCK = 0, 2

    def locking(handle: int, how: int, count: int) -> None:
        place = os.lseek(handle, 0, os.SEEK_CUR)
        kind = fcntl.LOCK_UN if how == made.LK_UNLCK else fcntl.LOCK_EX | fcntl.LOCK_NB
        try:
            fcntl.lockf(handle, kind, count, place)
        except BlockingIOError as error:
            raise PermissionError(error.errno, error.strerror) from None

    made.locking = locking
    return made


def import_all() -> int:
    """Import every module of both packages; return how many."""
    count = 0
    for package in ("twin", "reconstruction"):
        for item in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not item.name.startswith(OPTIONAL):
                importlib.import_module(item.name)
                count += 1
    return count


if __name__ == "__main__":
    hide()
    what, *arguments = sys.argv[1:]
    if what == "import":
        print(import_all(), "modules")
    else:
        sys.argv[1:] = arguments
        from twin.cli import main

        main()

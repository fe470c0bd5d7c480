"""How many threads the renderer takes: workers side by side share the cores."""

from twin.optics.backend import activate


def use_threads(count: int) -> None:
    """Let Dr.Jit use `count` threads in this process.

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    """
    activate()
    import drjit as dr

    dr.set_thread_count(count)

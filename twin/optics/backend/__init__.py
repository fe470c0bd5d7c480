"""Choice of the Dr.Jit backend, made in one place and proved in a child process.

Dr.Jit takes the first libLLVM it finds. LLVM older than 17 either does not load or aborts the whole
process at the first maximum of two floats ("Cannot select: fmaximum"), and Debian 12 and Ubuntu
22.04 install LLVM 14 or 15 by default. So each candidate library first has to compile and run the
kinds of kernel the twin needs, in a child process with an empty kernel cache; the first that gives
the right numbers is used. The finding is kept in the user's cache folder.

``TWIN_BACKEND`` (``llvm`` or ``cuda``) restricts the choice, ``DRJIT_LIBLLVM_PATH`` names the
library.
"""

from twin.optics.backend.choice import activate, find_backend, use_threads
from twin.optics.backend.probe import Backend, MissingBackend

__all__ = ["Backend", "MissingBackend", "activate", "find_backend", "use_threads"]

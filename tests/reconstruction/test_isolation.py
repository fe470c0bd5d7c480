import subprocess
import sys

FORBIDDEN = ("twin", "mitsuba", "drjit", "trimesh", "skfem", "pytetwild")
PROGRAM = """
import importlib, pkgutil, sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {forbidden}:
            raise ImportError("reconstruction must not import " + name)
sys.meta_path.insert(0, Block())
import reconstruction
for module in pkgutil.walk_packages(reconstruction.__path__, "reconstruction."):
    importlib.import_module(module.name)
"""


def test_every_module_imports_without_twin_and_renderer():
    program = PROGRAM.format(forbidden=set(FORBIDDEN))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

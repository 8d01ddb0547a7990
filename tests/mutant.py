"""Run the tests on a changed copy of the kernels and ops, for ``scripts/checks/mutation_check.py``.

CLGS_TEST_MUTANT names a folder with ``kernels_cl`` whole and, below ``clgs``, changed modules only.
"""

import importlib
import importlib.util
import sys
from pathlib import Path

VARIABLE = "CLGS_TEST_MUTANT"


def apply(folder: Path) -> None:
    """Make the package read kernels from ``folder`` and import its modules from there.

    Call it before anything else imports the package: other modules must see the changed ones.
    """
    for path in sorted((folder / "clgs").rglob("*.py")):
        name = ".".join(path.relative_to(folder).with_suffix("").parts)
        parent = importlib.import_module(name.rpartition(".")[0])
        if name in sys.modules:
            raise RuntimeError(f"{name} was imported before its changed copy")
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        setattr(parent, name.rpartition(".")[2], module)

    from clgs.opencl import programs

    programs.kernel_root = lambda: folder / "kernels_cl"
    if "#line" not in programs.read_program("scan/fits.cl"):
        raise RuntimeError(f"{folder}: kernels are not read from there")

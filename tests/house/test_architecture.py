"""The checkout obeys the rules of ARCHITECTURE.md."""

import re
from pathlib import Path

import pytest

from tests.house import kernel_rules, rules

ROOT = Path(__file__).resolve().parents[2]

STAGES = rules.op_paths(ROOT)
KERNEL_STAGES = [*STAGES, "limits"]
"""Stages of kernels; those that measure the device belong to the laboratory."""

TOPS = ("clgs", "kernels_cl", "codec_c", "scripts", "tests", "web")
SUFFIXES = {".py", ".cl", ".c", ".h", ".sh", ".js", ".css", ".html"}


def sources(*tops: str, suffixes: set[str] = frozenset({".py"})) -> dict[str, str]:
    """Text of every source below ``tops`` by its path from the root; links are not followed."""
    found = {}
    for top in tops:
        for path in sorted((ROOT / top).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if (
                path.suffix in suffixes
                and path.is_file()
                and not name.startswith("clgs/kernels_cl")
            ):
                found[name] = path.read_text(encoding="utf-8")
    return found


def dotted(path: str) -> str:
    """Module name of a path such as "clgs/ops/mlp.py"."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def flat(complaints: list[list[str]]) -> str:
    return "\n".join("\n".join(some) for some in complaints if some)


def test_imports_point_down():
    found = [rules.import_complaints(dotted(p), text) for p, text in sources("clgs").items()]
    assert not flat(found)


def test_imports_within_a_wing_point_one_way():
    found = {dotted(path): text for path, text in sources("clgs").items()}
    assert not rules.arrow_complaints(found)


def test_the_product_names_the_laboratory_only_where_it_is_asked_for():
    """An import by name is no way around the layers; `clgs COMMAND` loads commands by name."""
    product = {p: text for p, text in sources("clgs").items() if not p.startswith("clgs/lab/")}
    assert {p for p, text in product.items() if "clgs.lab" in text} == {"clgs/cli/main.py"}


def test_every_module_has_a_layer():
    names = {p.split("/")[1].removesuffix(".py") for p in sources("clgs")} - {"__init__"}
    assert names == set(rules.LEVEL)


def test_files_and_functions_stay_small():
    found = sources(*TOPS, suffixes=SUFFIXES)
    assert not flat([rules.length_complaints(p, text) for p, text in found.items()])


def kernel_stages() -> dict[str, str]:
    """Stage of every kernel."""
    texts = sources("kernels_cl", suffixes={".cl", ".h"}).values()
    kernels = [name for text in texts for name in rules.kernels_in(text)]
    return {name: rules.stage_of(name, KERNEL_STAGES) or "" for name in kernels}


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_has_its_kernels_reference_and_test(stage):
    room, _, name = STAGES[stage].rpartition("/")
    partners = (f"clgs/reference/{STAGES[stage]}.py", f"tests/ops/{room}/test_{name}.py")
    missing = [partner for partner in partners if not (ROOT / partner).is_file()]
    assert not missing, f"clgs/ops/{stage}.py lacks them"
    assert stage in kernel_stages().values(), f"clgs/ops/{stage}.py has no kernels"


def test_every_reference_has_its_op():
    references = (ROOT / "clgs" / "reference").rglob("*.py")
    assert {path.stem for path in references} - {"__init__"} == set(STAGES)


def test_kernels_are_named_by_their_stage():
    files = sources("kernels_cl", suffixes={".cl", ".h"}).items()
    assert not flat(
        [rules.kernel_file_complaints(path, text, KERNEL_STAGES) for path, text in files]
    )


def kernel_files() -> dict[str, str]:
    """Text of every kernel file by its path from kernels_cl."""
    found = sources("kernels_cl", suffixes={".cl", ".h"})
    return {path.removeprefix("kernels_cl/"): text for path, text in found.items()}


def test_kernel_helpers_are_static_inline():
    assert not flat([kernel_rules.inline_complaints(*item) for item in kernel_files().items()])


def test_no_loop_with_a_barrier_is_unrolled():
    assert not flat([kernel_rules.unroll_complaints(*item) for item in kernel_files().items()])


def test_kernel_files_of_a_form_are_pairs():
    assert not kernel_rules.form_complaints(kernel_files())


def test_kernel_files_include_what_they_use():
    assert not kernel_rules.include_complaints(kernel_files())


def test_kernel_types_options_and_headers_have_one_home():
    assert not kernel_rules.name_complaints(kernel_files())


def test_kernels_are_fetched_by_their_stage():
    kernels, code = kernel_stages(), sources("clgs")
    assert not flat([rules.fetch_complaints(p, text, kernels) for p, text in code.items()])
    ops = "".join(text for p, text in code.items() if p.startswith(("clgs/ops/", "clgs/lab/")))
    orphans = [name for name in kernels if f'"{name}"' not in ops]
    assert not orphans, "nobody fetches these kernels"


def test_shipped_code_runs_no_foreign_code():
    code = sources("clgs", "scripts")
    assert not flat([rules.safety_complaints(p, text) for p, text in code.items()])


def test_architecture_lists_the_folders_that_exist():
    listed = rules.listed_folders((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    assert listed == existing_folders()


def test_architecture_names_paths_that_exist():
    named = rules.named_paths((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    assert len(named) > 20
    bases = ROOT, ROOT / "clgs", ROOT / "clgs" / "codec"
    assert not [
        name
        for name in sorted(named)
        if not any((base / f"{name}{suffix}").exists() for base in bases for suffix in ("", ".py"))
    ]


def test_a_name_means_one_class():
    """A reference shares names with its op, and ``clgs.torch`` offers what ``clgs`` does."""
    found: dict[str, list[str]] = {}
    for path, text in sources("clgs").items():
        if not path.startswith(("clgs/reference/", "clgs/torch/")):
            for name in re.findall(r"^class (\w+)", text, re.MULTILINE):
                found.setdefault(name, []).append(path)
    assert not {name: paths for name, paths in found.items() if len(paths) > 1}


def test_sources_name_modules_that_exist():
    """``clgs.a.b`` in a docstring or a comment is a module, or a name of the module before it."""
    wrong = []
    for path, text in sources("clgs", "kernels_cl", suffixes={".py", ".cl", ".h"}).items():
        for name in set(re.findall(r"``?(clgs(?:\.\w+)+)", text)):
            place, owner = ROOT / "clgs", ROOT / "clgs" / "__init__.py"
            for part in name.split(".")[1:]:
                if (place / part).is_dir():
                    place, owner = place / part, place / part / "__init__.py"
                elif (place / f"{part}.py").is_file():
                    place, owner = place / part, place / f"{part}.py"
                elif re.search(rf"\b{part}\b", owner.read_text(encoding="utf-8")):
                    break
                else:
                    wrong.append(f"{path}: {name}")
                    break
    assert not sorted(wrong)


def existing_folders() -> set[str]:
    """Folders two levels deep with a file in or below them, but for those that git ignores."""
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    ignored = {line.strip().strip("/") for line in lines}
    folders = set()
    for folder in [*ROOT.iterdir(), *ROOT.glob("*/*")]:
        parts = folder.relative_to(ROOT).parts
        private = parts[0].startswith(".") and parts[0] != ".ci"
        if private or folder.is_symlink() or not folder.is_dir():
            continue
        if ignored & {*parts, "/".join(parts)} or (ROOT / parts[0] / "pyvenv.cfg").exists():
            continue
        if any(p.is_file() for p in folder.rglob("*") if "__pycache__" not in p.parts):
            folders.add("/".join(parts))
    return folders

"""The rules of ARCHITECTURE.md that a machine can check, as functions from text to complaints."""

import ast
import functools
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path, PurePath

LAYERS = [  # a package may import from its own row and the rows above it
    {"arguments", "constants", "errors", "files", "machine"} | {"options", "reference", "shapes"},
    {"opencl", "scene"},
    {"ops", "codec", "data"},
    {"render", "exports", "poses"},
    {"jax", "torch", "train"},
    {"cluster", "viewer", "workflow"},
    {"cli", "doctor"},
    {"__main__", "lab"},  # the laboratory measures the product, which never needs it
]
LEVEL = {name: level for level, row in enumerate(LAYERS) for name in row}

MAX_FILE_LINES = 400

ONLY_HERE = {"pyopencl": "clgs.opencl"}
"""Libraries that a single package may import."""

OPS_NEVER = ("clgs.scene.scene",)
"""Ops know arrays, anchors, cameras and devices, never a whole scene with its settings."""

REFERENCE_ONLY = ("numpy", "clgs.constants", "clgs.shapes", "clgs.reference")
"""References import these and the standard library, and nothing else."""

UNSAFE_MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
UNSAFE_CALLS = {"eval", "exec", "__import__", "os.system", "os.popen", "yaml.load"}
UNSAFE_NAMES = {name.split(".")[-1] for name in UNSAFE_CALLS}
UNSAFE_KEYWORDS = {"shell", "allow_pickle"}


def blocks(text: str) -> Iterator[list[ast.AST]]:
    """Every list of statements, handlers or cases: far less than all nodes."""
    todo: list[ast.AST] = [ast.parse(text)]
    while todo:
        node = todo.pop(0)
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            if found := getattr(node, name, []):
                yield found
                todo += found


@functools.cache
def imported_names(text: str) -> list[tuple[int, str]]:
    """(line, dotted name) of every import, lazy ones too; a relative import starts with a dot."""
    found = []
    for node in chain.from_iterable(blocks(text)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            found += [(node.lineno, f"{base}.{alias.name}") for alias in node.names]
    return found


def package_of(module: str) -> str | None:
    """The part of clgs that has a layer, for example "ops" of "clgs.ops.mlp"; else None."""
    parts = module.split(".")
    return parts[1] if parts[0] == "clgs" and len(parts) > 1 and parts[1] in LEVEL else None


def import_complaints(module: str, text: str) -> list[str]:
    """Imports of ``module`` (dotted name) that break a layer or belong to another package."""
    return [
        f"{module}:{line}: {complaint}"
        for line, name in imported_names(text)
        if (complaint := _import_complaint(module, name))
    ]


def _import_complaint(module: str, name: str) -> str | None:
    own, other, top = package_of(module), package_of(name), name.split(".")[0]
    if name.startswith("."):
        return "write the import in full"
    if own and other and LEVEL[other] > LEVEL[own]:
        return f"{own} imports {other}, a layer above it"
    if top in ONLY_HERE and not module.startswith(ONLY_HERE[top]):
        return f"only {ONLY_HERE[top]} imports {top}"
    if own == "ops" and _within(name, OPS_NEVER):
        return f"ops never know {name}"
    if own == "reference" and top in {"numpy", "scipy", "clgs"}:
        return None if _within(name, REFERENCE_ONLY) else f"references never import {name}"
    return None


def _within(name: str, packages: tuple[str, ...]) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def arrow_complaints(modules: Mapping[str, str]) -> list[str]:
    """Circles of imports among the sub-packages of a wing; ``modules``: dotted name -> text."""
    wings = {name.split(".")[1] for name in modules if name.count(".") >= 3}
    parts = {wing: {n.split(".")[2] for n in modules if _is_inside(n, wing)} for wing in wings}
    arrows: dict[str, dict[str, set[str]]] = {wing: defaultdict(set) for wing in wings}
    for module, text in modules.items():
        wing = module.split(".")[1] if module.count(".") >= 3 else None
        for _, name in imported_names(text) if wing else ():
            pieces = name.split(".")
            if pieces[:2] == ["clgs", wing] and len(pieces) > 2 and pieces[2] in parts[wing]:
                arrows[wing][module.split(".")[2]].add(pieces[2])
    found = []
    for wing, graph in sorted(arrows.items()):
        others = {part: targets - {part} for part, targets in graph.items()}
        try:
            TopologicalSorter(others).prepare()
        except CycleError as error:
            found.append(f"clgs/{wing}: {' <- '.join(error.args[1])} import each other in a circle")
    return found


def _is_inside(module: str, wing: str) -> bool:
    """Whether ``module`` lies in a sub-package of ``wing``."""
    return module.startswith(f"clgs.{wing}.") and module.count(".") >= 3


def length_complaints(name: str, text: str) -> list[str]:
    """The file is too long. Functions have no such limit: ruff bounds how complex they are."""
    lines = text.count("\n")
    return [f"{name}: {lines} lines, at most {MAX_FILE_LINES}"] if lines > MAX_FILE_LINES else []


def without_attributes(text: str) -> str:
    """C text without its __attribute__((...))."""
    return re.sub(r"__attribute__\s*\(\((?:[^()]|\([^()]*\))*\)\)", "", text)


_COMMENT_OR_STRING = re.compile(
    r"""/\*.*?\*/ | //[^\n]* | "(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])+' """, re.S | re.X
)
_DIRECTIVE = re.compile(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", re.M)


def without_comments(text: str) -> str:
    """C text with blanks for comments and strings, but for those of includes; positions stay."""
    return _COMMENT_OR_STRING.sub(
        lambda match: match[0] if _is_included(text, match.start()) else _blank(match[0]), text
    )


def _is_included(text: str, start: int) -> bool:
    return re.fullmatch(r"[ \t]*#[ \t]*include[ \t]*", text[:start].rpartition("\n")[2]) is not None


def _blank(text: str) -> str:
    return re.sub(r"[^\n]", " ", text)


def plain_c(text: str) -> str:
    """C text with blanks for comments, strings and preprocessor lines; positions stay."""
    return _DIRECTIVE.sub(lambda match: _blank(match[0]), without_comments(text))


def kernels_in(text: str) -> list[str]:
    """Names of the kernels that an OpenCL source defines, each once, in order."""
    plain = without_attributes(plain_c(text))
    found = re.findall(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(", plain)
    return list(dict.fromkeys(found))


def stage_of(kernel: str, stages: Iterable[str]) -> str | None:
    """The stage that a kernel such as "blend_forward" belongs to, by its name."""
    return max((stage for stage in stages if kernel.startswith(f"{stage}_")), key=len, default=None)


def kernel_file_complaints(path: str, text: str, stages: Iterable[str]) -> list[str]:
    """What is wrong with the kernels of ``path``, such as "kernels_cl/blend/forward_cpu.cl".

    A program holds kernels of one stage, named after it; the file's room or its
    own name begins with that stage.
    """
    kernels = kernels_in(text)
    if path.endswith(".h"):
        return [f"{path}: a header holds a kernel"] if kernels else []
    if not kernels:
        return [f"{path}: holds no kernel"]
    found = {name: stage_of(name, stages) for name in kernels}
    room, stem = path.removesuffix(".cl").split("/")[-2:]
    if len(set(found.values())) > 1:
        return [f"{path}: holds kernels of several stages"]
    return [
        f"{path}: kernel {name} is not named <stage>_<verb> by its room or file"
        for name, stage in found.items()
        if stage is None or not (room == stage or f"{stem}_".startswith(f"{stage}_"))
    ]


def fetch_complaints(path: str, text: str, kernels: dict[str, str]) -> list[str]:
    """Kernel names (``kernels``: name -> stage) that ``path`` uses without being their op.

    The laboratory may fetch any: it builds them again, to observe them.
    """
    if path.startswith("clgs/lab/"):
        return []
    return [
        f"{path}:{node.lineno}: {node.value} belongs to the op {kernels[node.value]}"
        for node in (ast.walk(ast.parse(text)) if any(name in text for name in kernels) else ())
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value in kernels
        and not (path.startswith("clgs/ops/") and PurePath(path).stem == kernels[node.value])
    ]


def safety_complaints(path: str, text: str) -> list[str]:
    """Uses of pickle and its kin, eval, exec and shells."""
    complaints = [
        f"{path}:{line}: imports {name}"
        for line, name in imported_names(text)
        if name.split(".")[0] in UNSAFE_MODULES
    ]
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call):
            continue
        last = getattr(node.func, "attr", getattr(node.func, "id", None))  # unparsing takes long
        if last in UNSAFE_NAMES and (called := ast.unparse(node.func)) in UNSAFE_CALLS:
            complaints.append(f"{path}:{node.lineno}: calls {called}")
        complaints += [
            f"{path}:{node.lineno}: {keyword.arg}={ast.unparse(keyword.value)}"
            for keyword in node.keywords
            if keyword.arg in UNSAFE_KEYWORDS and ast.unparse(keyword.value) != "False"
        ]
    return complaints


def op_paths(root: Path) -> dict[str, str]:
    """Where the op of every stage lies in clgs/ops, such as "general/views", by the stage."""
    ops = root / "clgs/ops"
    paths = [path for path in sorted(ops.rglob("*.py")) if path.stem != "__init__"]
    return {path.stem: path.relative_to(ops).with_suffix("").as_posix() for path in paths}


def listed_folders(document: str) -> set[str]:
    """Folders that the table of ARCHITECTURE.md's section "Folders" names."""
    section = document.split("## Folders", 1)[-1].split("\n## ", 1)[0]
    return set(re.findall(r"^\| `([^`]+)/` \|", section, flags=re.M))


def named_paths(document: str) -> set[str]:
    """What a document names as a path from the root or from ``clgs``, suffixes left out or not.

    In backticks and in its figures; names with ``<``, ``*`` or blanks are patterns, not paths.
    """
    marked = re.findall(r"`([^`\n]+)`", document)
    drawn = [word for block in document.split("```")[1::2] for word in block.split()]
    path = re.compile(r"(?:[\w.-]+/)+[\w.-]*\w")
    return {word for word in (*marked, *drawn) if path.fullmatch(word)}

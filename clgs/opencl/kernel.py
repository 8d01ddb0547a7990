"""A kernel, and the contract of its arguments: a launch names them, the kernel's source types them.

A wrong name, a missing or a further one, and a wrong type are errors before anything runs. OpenCL
lets a driver forget names and types (clGetKernelArgInfo is optional). So they are read from the
source as it is built, with a preprocessor for as much of C's as ``kernels_cl`` uses: conditions and
macros.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from clgs.opencl.array import DeviceArray

Macros = dict[str, tuple[list[str] | None, str]]
"""Parameters, None of a macro that takes none, and the text that it stands for."""

DTYPES = {
    "char": np.int8,
    "uchar": np.uint8,
    "short": np.int16,
    "ushort": np.uint16,
    "int": np.int32,
    "uint": np.uint32,
    "long": np.int64,
    "ulong": np.uint64,
    "float": np.float32,
}
"""NumPy's types by those of OpenCL C."""

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*|\\\n", re.S)
_DIRECTIVE = re.compile(r"\s*#\s*(\w+)\s*(.*)")
_DEFINE = re.compile(r"(\w+)(?:\(([^)]*)\))?(?:\s+(.*))?$")
_DEFINED = re.compile(r"\bdefined\s*(?:\(\s*(\w+)\s*\)|(\w+))")
_NAME = re.compile(r"\b[A-Za-z_]\w*\b")
_KERNEL = re.compile(r"\b(?:__)?kernel\s+(?:__attribute__\s*\(\([^;{]*?\)\)\s*)?void\s+(\w+)\s*\(")
_PARAMETER = re.compile(
    r"(?:(?:__)?(?P<space>global|constant|local)\s+)?(?:const\s+)?"
    r"(?P<type>[a-z]+)(?P<lanes>\d*)\s+(?P<pointer>\*?)\s*(?:restrict\s+)?(?P<name>\w+)"
)
_OPERATORS: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Not: operator.not_,
    ast.USub: operator.neg,
}


@dataclass(frozen=True)
class Parameter:
    """A parameter of a kernel: a pointer into an address space, a number or a vector of numbers.

    space: "global", "constant" or "local" of a pointer, else "". dtype: of a number. lanes: numbers
    of a vector; 1 of a pointer and of a number.
    """

    name: str
    space: str
    dtype: np.dtype[Any]
    lanes: int = 1

    def __str__(self) -> str:
        if self.lanes > 1:
            return f"a vector of {self.lanes} {self.dtype}"
        return f"{'an array' if self.space else 'a number'} of {self.dtype}"


def signatures(source: str, options: Mapping[str, str]) -> dict[str, tuple[Parameter, ...]]:
    """The parameters, in order, of every kernel that a program defines.

    Args:
        source: of the program, includes expanded.
        options: macros that the build defines, by name.

    Raises:
        ValueError: a parameter's type or a condition is none that is known here.
    """
    text, macros = preprocess(source, options)
    found = {}
    for kernel in _KERNEL.finditer(text):
        listed = expand(_in_parentheses(text, kernel.end() - 1), macros)
        found[kernel[1]] = tuple(_parameter(one) for one in listed.split(","))
    return found


def _parameter(text: str) -> Parameter:
    match = _PARAMETER.fullmatch(text.strip())
    if not match or match["type"] not in DTYPES or bool(match["space"]) != bool(match["pointer"]):
        raise ValueError(f"kernel parameter '{text.strip()}' is neither pointer, number nor vector")
    lanes = 1 if match["space"] else int(match["lanes"] or 1)
    return Parameter(match["name"], match["space"] or "", np.dtype(DTYPES[match["type"]]), lanes)


def preprocess(source: str, options: Mapping[str, str]) -> tuple[str, Macros]:
    """The lines that conditions keep, without directives, and the macros at the end of the text.

    Raises:
        ValueError: a condition is none that is known here.
    """
    macros: Macros = {name: (None, value) for name, value in options.items()}
    kept: list[str] = []
    branches = [(True, True)]
    """Each open #if: whether its lines are kept, and whether no later branch may be kept."""
    for line in _COMMENT.sub(" ", source).splitlines():
        directive = _DIRECTIVE.match(line)
        active = branches[-1][0]
        if not directive:
            if active:
                kept.append(line)
        elif directive[1] in ("if", "ifdef", "ifndef"):
            chosen = active and _condition(directive[1], directive[2], macros)
            branches.append((chosen, chosen or not active))
        elif directive[1] in ("elif", "else"):
            _, done = branches.pop()
            chosen = not done and _condition(directive[1], directive[2], macros)
            branches.append((chosen, chosen or done))
        elif directive[1] == "endif":
            branches.pop()
        elif active and directive[1] == "define" and (match := _DEFINE.match(directive[2])):
            parameters = match[2].replace(" ", "").split(",") if match[2] is not None else None
            macros[match[1]] = (parameters, match[3] or "")
    return "\n".join(kept), macros


def _condition(directive: str, text: str, macros: Macros) -> bool:
    """Whether the lines after #if, #ifdef, #ifndef, #elif or #else are kept."""
    if directive == "else":
        return True
    if directive in ("ifdef", "ifndef"):
        return (text.split()[0] in macros) == (directive == "ifdef")
    answered = _DEFINED.sub(lambda match: str(int((match[1] or match[2]) in macros)), text)
    value = evaluate(expand(answered, macros))
    if value is None:
        raise ValueError(f"#{directive} {text}: this condition is not understood")
    return bool(value)


def evaluate(text: str) -> int | None:
    """An integer expression of C, in which names stand for 0; None if it is none."""
    python = re.sub(r"!(?!=)", " not ", text.replace("&&", " and ").replace("||", " or "))
    python = re.sub(r"\b(0x[0-9a-fA-F]+|\d+)[uU]\b", r"\1", python.replace("/", "//"))
    try:
        return _value(ast.parse(python.strip(), mode="eval").body)
    except (SyntaxError, KeyError, ZeroDivisionError):
        return None


def _value(node: ast.expr) -> int:
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        return node.value
    if isinstance(node, ast.Name):
        return 0
    if isinstance(node, ast.BoolOp):
        values = (_value(one) for one in node.values)
        return int(all(values) if isinstance(node.op, ast.And) else any(values))
    if isinstance(node, ast.UnaryOp):
        return int(_OPERATORS[type(node.op)](_value(node.operand)))
    if isinstance(node, ast.BinOp):
        return int(_OPERATORS[type(node.op)](_value(node.left), _value(node.right)))
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        left, right = _value(node.left), _value(node.comparators[0])
        return int(_OPERATORS[type(node.ops[0])](left, right))
    raise KeyError(type(node))


def expand(text: str, macros: Macros, within: frozenset[str] = frozenset()) -> str:
    """``text`` with macros replaced, but for those in ``within``, which are being replaced."""
    out, start = [], 0
    while match := _NAME.search(text, start):
        parameters, body = macros.get(match[0], (None, match[0]))
        out.append(text[start : match.start()])
        start = match.end()
        if match[0] not in macros or match[0] in within:
            out.append(match[0])
            continue
        if parameters is not None:
            opening = re.compile(r"\s*\(").match(text, start)
            if not opening:
                out.append(match[0])
                continue
            given = _in_parentheses(text, opening.end() - 1)
            start = opening.end() + len(given) + 1
            values = dict(zip(parameters, (one.strip() for one in given.split(",")), strict=False))
            words = re.split(r"\b([A-Za-z_]\w*)\b", body)
            body = "".join(values.get(word, word) for word in words)
            body = re.sub(r"\s*##\s*", "", body)
        out.append(expand(body, macros, within | {match[0]}))
    return "".join([*out, text[start:]])


def _in_parentheses(text: str, opening: int) -> str:
    """What stands between the parenthesis at ``opening`` and the one that closes it."""
    depth = 0
    for match in re.compile(r"[()]").finditer(text, opening):
        depth += 1 if match[0] == "(" else -1
        if depth == 0:
            return text[opening + 1 : match.start()]
    raise ValueError("a parenthesis is not closed")


Argument: TypeAlias = DeviceArray | np.generic | npt.NDArray[Any]
"""An array on the device, a number, or a vector of 2 to 16 numbers."""


class Kernel:
    """A kernel that was built, and its parameters in order."""

    def __init__(self, built: cl.Kernel, parameters: tuple[Parameter, ...]) -> None:
        """``built`` from a source that declares ``parameters``."""
        self.name = str(built.function_name)
        self.built = built
        self.lock = Lock()  # of its arguments: other threads must not set theirs before the launch
        self.parameters = parameters
        self._names = [one.name for one in parameters]
        self._dtypes = [one.dtype for one in parameters]
        self._types = [_type(one) for one in parameters]
        self._arrays = [i for i, one in enumerate(parameters) if one.space]
        self._vectors = [(i, (one.lanes,)) for i, one in enumerate(parameters) if one.lanes > 1]
        # pyopencl asks nothing of arguments whose types it knows
        built.set_arg_types([None if one.space else _packed(one) for one in parameters])

    def ordered(self, arguments: dict[str, Any]) -> list[Any]:
        """What pyopencl takes, in the kernel's order.

        Raises:
            TypeError: a name or a type is not that of the kernel's parameter.
        """
        try:
            values = [arguments[name] for name in self._names]
        except KeyError:
            raise self._complaint(arguments) from None
        if (
            len(values) != len(arguments)
            or [type(value) for value in values] != self._types
            or [value.dtype for value in values] != self._dtypes
        ):
            raise self._complaint(arguments)
        for i, shape in self._vectors:
            if values[i].shape != shape:
                raise self._complaint(arguments)
        for i in self._arrays:
            values[i] = values[i].buffer
        return values

    def _complaint(self, arguments: dict[str, Any]) -> TypeError:
        for name in arguments:
            if name not in self._names:
                return TypeError(f"kernel {self.name} has no argument {name}")
        for parameter in self.parameters:
            if parameter.name not in arguments:
                return TypeError(f"kernel {self.name} lacks its argument {parameter.name}")
            found = _described(arguments[parameter.name])
            if found != str(parameter):
                return TypeError(
                    f"kernel {self.name}: argument {parameter.name} is {found}, "
                    f"the kernel takes {parameter}"
                )
        return TypeError(f"kernel {self.name}: an argument does not fit")


def _type(parameter: Parameter) -> type:
    if parameter.space:
        return DeviceArray
    return np.ndarray if parameter.lanes > 1 else parameter.dtype.type


def _packed(parameter: Parameter) -> np.dtype[Any]:
    """How pyopencl passes a number; a vector goes as the bytes that it is."""
    whole = np.dtype((np.void, parameter.lanes * parameter.dtype.itemsize))
    return whole if parameter.lanes > 1 else parameter.dtype


def _described(value: Any) -> str:
    """A given argument, in the words of ``str(Parameter)``."""
    if isinstance(value, DeviceArray):
        return f"an array of {value.dtype}"
    if isinstance(value, np.generic):
        return f"a number of {value.dtype}"
    if isinstance(value, np.ndarray) and value.ndim == 1:
        return f"a vector of {len(value)} {value.dtype}"
    return f"of type {type(value).__name__}"

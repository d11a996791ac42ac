"""Kernels and functions in C++ and CUDA: the files of the folder `native`, and how Warp is given them.

Warp takes the body of a function and a typed stub, and nothing around them. So for a function of a file

- its arguments become those of the stub, with Warp's types; a `Number` becomes a number and a scalar on the device,
  which holds it if there is one;
- what its body uses of the file, and of the files that this includes, stands before it: constants as they are, `inline`
  functions as lambdas;
- what it is specialised for is defined around it for the preprocessor.

The text that Warp gets holds all of that, so that a change of a file compiles anew what depends on it.
"""

import linecache
import re
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

from .threads import once

_FOLDER = Path(__file__).parent / "native"
_INCLUDE = re.compile(r'^#include "(.+)"$', re.MULTILINE)
_PART = re.compile(
    r"^(?:constexpr [^;]*?(?P<constant>\w+)(?:\[\])? = [^;]*;"
    r"|(?P<kind>inline )?(?P<result>[\w: ]+?) (?P<name>\w+)\((?P<arguments>[^{]*)\) \{\n(?P<body>.*?)^\})",
    re.MULTILINE | re.DOTALL,
)
_ARGUMENT = re.compile(r"(?:Array(?P<dimensions>[1-4])<(?P<element>\w+)>|(?P<type>\w+)) (?P<name>\w+)")
_SCALARS = {wp.uint8: "unsigned char", wp.uint16: "unsigned short", wp.float16: "wp::half", wp.float32: "float"}
_TYPES = {"float": float, "int": int, "bool": bool, "double": wp.float64}


class _Part(NamedTuple):
    """A constant or a function of a file."""

    name: str
    text: str  # as it stands before the body of another function; of what Warp calls, the body
    arguments: str | None  # of what Warp calls


@cache
def _parts(file: str) -> dict[str, _Part]:
    """Return the constants and functions of a file by name, those of the files that it includes first."""
    text = (_FOLDER / file).read_text(encoding="utf-8")
    found: dict[str, _Part] = {}
    for included in _INCLUDE.findall(text):
        found |= _parts(included)
    for part in _PART.finditer(text):
        if part["constant"]:
            found[part["constant"]] = _Part(part["constant"], f"    {part[0]}\n", None)
        elif part["kind"]:
            result = "" if part["result"] == "auto" else f" -> {part['result']}"
            as_lambda = f"    auto {part['name']} = [&]({part['arguments']}){result} {{\n{part['body']}    }};\n"
            found[part["name"]] = _Part(part["name"], as_lambda, None)
        else:
            found[part["name"]] = _Part(part["name"], part["body"], part["arguments"])
    return found


def _assembled(file: str, name: str, numbers: dict[str, Any]) -> str:
    """Return the body of a function with all that it needs before it."""
    parts = _parts(file)
    text = parts[name].text
    for part in reversed([part for part in parts.values() if part.arguments is None]):
        if re.search(rf"\b{part.name}\b", text):
            text = part.text + text
    defined = "".join(f"#define {number} {_written(value)}\n" for number, value in numbers.items())
    code = f"\n{defined}{text}" + "".join(f"#undef {number}\n" for number in numbers)
    if file.endswith(".cuh"):
        return code
    return f"\n{{\n#pragma clang fp contract(fast)\n{code}}}\n"  # as GPUs do products and sums anyway


def _written(value: Any) -> str:
    """Write a number, or several, in C++."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value}f"
    return ", ".join(map(_written, value)) if isinstance(value, tuple) else str(value)


def _annotations(arguments: str, types: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and Warp's types of the arguments of a function."""

    def type_of(name: str) -> Any:
        return types[name] if name in types else _TYPES[name] if name in _TYPES else getattr(wp, name)

    for argument in arguments.split(","):
        match = _ARGUMENT.fullmatch(argument.strip())
        assert match is not None, f"{argument.strip()!r} is no argument that Warp can give"
        if match["type"] == "Number":
            yield f"{match['name']}_given", float
            yield f"{match['name']}_there", wp.array(dtype=wp.float64)
        elif match["element"]:
            yield match["name"], wp.array(dtype=type_of(match["element"]), ndim=int(match["dimensions"]))
        else:
            yield match["name"], type_of(match["type"])


def defined(name: str, arguments: dict[str, Any], body: str, names: dict[str, Any]) -> Any:
    """Make a Python function with these arguments, whose text Warp finds."""
    text = f"def {name}({', '.join(f'{argument}: {argument}_type' for argument in arguments)}):\n    {body}\n"
    place = f"<native {name} {len(linecache.cache)}>"
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    scope = {"__name__": __name__, **names, **{f"{argument}_type": kind for argument, kind in arguments.items()}}
    exec(compile(text, place, "exec", dont_inherit=True), scope)
    return scope[name]


def _split(given: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Types and numbers apart."""
    types = {name: value for name, value in given.items() if isinstance(value, type) or hasattr(value, "vars")}
    return types, {name: value for name, value in given.items() if name not in types}


def c_type(scalar: Any, *, for_vectors: bool = False) -> str:
    """Return the C++ name of a type of Warp; that of half precision is a class, of which a CPU makes no vectors."""
    return "_Float16" if for_vectors and scalar is wp.float16 else _SCALARS[scalar]


def names_of(pixel: Any) -> dict[str, Any]:
    """Return the C++ names of a pixel that a GPU loads at once: its length PAD, scalars KEPT, and WORDS of its size."""
    scalar, length = pixel._wp_scalar_type_, pixel._length_
    words = {2: "unsigned short", 4: "unsigned", 8: "uint2", 16: "uint4"}
    return {"PAD": length, "KEPT": _SCALARS[scalar], "WORDS": words[length * wp.types.type_size_in_bytes(scalar)]}


def function(file: str, name: str, **given: Any) -> Any:
    """Make a function of a file of `native`, for kernels in Warp's language; `given` is what it is specialised for.

    Warp's types stand by the names that the arguments have for them, and numbers by the names that are defined for the
    preprocessor. A tuple is several numbers, text is C++.
    """
    types, numbers = _split(given)
    arguments = _parts(file)[name].arguments
    assert arguments is not None, f"{name} is for other functions of {file}"
    named = re.findall(r"\bNumber (\w+)", arguments)
    read = "".join(f"    const float {n} = {n}_there.data ? (float){n}_there.data[0] : {n}_given;\n" for n in named)
    stub = defined(name, dict(_annotations(arguments, types)), "...", {})
    body = _assembled(file, name, numbers)
    return wp.func_native(f"{read}{{\n{body}}}\n" if read else body)(stub)


def kernel(
    file: str,
    name: str,
    *,
    module: str | None = None,
    launch_bounds: tuple[int, int] | None = None,
    **given: Any,
) -> Any:
    """Make a kernel that is a function of a file of `native`, specialised as by `function`, the first time; keep it.

    An argument `int tid` at the beginning is the index of the thread; the others are given when it is launched.
    `module` is the module of Warp that it is compiled in, by default one for each specialisation; `launch_bounds` are
    the threads of a block on a GPU, and the blocks that a multiprocessor is to hold at once.
    """
    return _kept(file, name, module, launch_bounds, tuple(given.items()))


@once
def _kept(
    file: str,
    name: str,
    module: str | None,
    launch_bounds: tuple[int, int] | None,
    items: tuple[tuple[str, Any], ...],
) -> Any:
    given = dict(items)
    types, _ = _split(given)
    native = function(file, name, **given)
    arguments = dict(_annotations(_parts(file)[name].arguments or "", types))
    indexed = "tid" in arguments
    passed = ", ".join("wp.tid()" if argument == "tid" else argument for argument in arguments)
    names = {"wp": wp, "native": native}
    called = {argument: kind for argument, kind in arguments.items() if not (indexed and argument == "tid")}
    calling = defined(f"{name}_kernel", called, f"native({passed})", names)
    if module is None:
        kind = zlib.crc32(repr([(key, _said(value)) for key, value in items]).encode())
        module = f"lfgpu_{file.replace('.', '_')}_{name}_{kind:08x}"
    return wp.kernel(calling, module=module, enable_backward=False, launch_bounds=launch_bounds)


def _said(value: Any) -> str:
    """Write what a kernel is specialised for, the same in each process."""
    if isinstance(value, type):
        return f"{getattr(value, '_wp_scalar_type_', value).__name__}{getattr(value, '_length_', '')}"
    return value.key if hasattr(value, "vars") else repr(value)

"""Operations that a function of one pixel is: the kernel around it, and its launch."""

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from .native_code import defined
from .threads import launch_rows
from .vector import given, value_of

Field: Any = wp.array2d(dtype=float)
Volume: Any = wp.array3d(dtype=float)


Number: Any = type("Number", (), {})
"""The type of an argument that is a number, or a scalar on the device that holds it."""


def pixelwise(module: str, *, light: bool = False) -> Callable[[Any], Callable[..., None]]:
    """Make an operation of a function of the pixel (y, x), which writes there what its further arguments hold.

    The operation has these arguments. Its pixels are those of the last array among them; a function of (n, y, x) has
    those of a stack [n, y, x]. `module` is the module of Warp that the kernel is compiled in; `light` is that of
    `launch_rows`.
    """

    def made(function: Any) -> Callable[..., None]:
        kinds = {name: kind for name, kind in function.__annotations__.items() if name not in ("n", "y", "x")}
        is_stack = "n" in function.__annotations__
        last = [name for name, kind in kinds.items() if isinstance(kind, wp.array)][-1]
        function.__annotations__.update({name: float for name, kind in kinds.items() if kind is Number})
        names = {"wp": wp, "value_of": value_of, "function": wp.func(function, module=module)}
        lines, arguments = ["i = wp.tid()", "y = row + i / lanes"], dict[str, Any]()
        for name, kind in kinds.items():
            if kind is Number:
                arguments |= {f"{name}_given": float, f"{name}_there": wp.array(dtype=wp.float64)}
                lines.append(f"{name} = value_of({name}_given, {name}_there)")
            elif name != last:
                arguments[name] = kind
        arguments |= {"row": int, "lanes": int, last: kinds[last]}
        if is_stack:
            lines += [f"n = y / {last}.shape[1]", f"y = y - n * {last}.shape[1]"]
        lines.append(f"for x in range(i % lanes, {last}.shape[{kinds[last].ndim - 1}], lanes):")
        lines.append(f"    function({'n, ' if is_stack else ''}y, x, {', '.join(kinds)})")
        text = defined(f"{function.__name__}_kernel", arguments, "\n    ".join(lines), names)
        kernel = wp.kernel(text, module=module, enable_backward=False)

        def operation(*placed: Any, **named: Any) -> None:
            values = dict(zip(kinds, placed, strict=False)) | named
            inputs: list[Any] = []
            for name, kind in kinds.items():
                if name != last:
                    inputs += given(values[name]) if kind is Number else [values[name]]
            rows = math.prod(values[last].shape[:-1]) if is_stack else None
            launch_rows(kernel, inputs, values[last], rows=rows, light=light)

        return operation

    return made

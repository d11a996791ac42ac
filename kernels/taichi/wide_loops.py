"""Loops of a kernel in enough threads for a large GPU.

On Vulkan, Taichi starts 131072 threads for every loop whose end it learns at the launch: not half of those that a large
GPU keeps at once to hide the time that memory takes. For a loop whose end it knows, it starts a thread for each turn.
So such a loop is compiled as a loop over a fixed number of threads, each of which makes some turns of it.
"""

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from taichi.lang import kernel_impl


@contextmanager
def in_threads(count: int) -> Iterator[None]:
    """Have kernels that are compiled meanwhile make their loops in `count` threads."""
    read = kernel_impl._get_tree_and_ctx

    def read_and_widen(*arguments: Any, is_kernel: bool = True, **named: Any) -> Any:
        tree, context = read(*arguments, is_kernel=is_kernel, **named)
        if is_kernel:
            _widen(tree.body[0], count)
        return tree, context

    kernel_impl._get_tree_and_ctx = read_and_widen
    try:
        yield
    finally:
        kernel_impl._get_tree_and_ctx = read


def _widen(kernel: ast.FunctionDef, count: int) -> None:
    known = {each.arg for each in kernel.args.args if ast.unparse(each.annotation or each) != "ti.template()"}
    is_own = False  # a loop that has a configuration of its own keeps its threads, which may work together
    for place, statement in enumerate(kernel.body):
        if isinstance(statement, ast.For) and not is_own and (end := _end(statement, known)) is not None:
            kernel.body[place] = _in_threads(statement, end, count)
        is_own = ast.unparse(statement).startswith("ti.loop_config(")
        names = (name for name in ast.walk(statement) if isinstance(name, ast.Name))
        known |= {name.id for name in names if isinstance(name.ctx, ast.Store)}


def _end(loop: ast.For, known: set[str]) -> ast.expr | None:
    """Return the end of a loop over `range(end)` that names what is known at the launch only; None for others."""
    call = loop.iter
    if not isinstance(call, ast.Call) or ast.unparse(call.func) != "range" or len(call.args) != 1:
        return None
    named = {name.id for name in ast.walk(call.args[0]) if isinstance(name, ast.Name)}
    return call.args[0] if named & known else None


def _in_threads(loop: ast.For, end: ast.expr, count: int) -> ast.For:
    wide = ast.parse(
        f"for thread_ in range({count}):\n"
        f"    for turn_ in range(({ast.unparse(end)} - 1 - thread_) // {count} + 1):\n"
        f"        {ast.unparse(loop.target)} = thread_ + turn_ * {count}\n"
    ).body[0]
    for node in ast.walk(wide):
        ast.copy_location(node, loop)
    assert isinstance(wide, ast.For)
    turns = wide.body[0]
    assert isinstance(turns, ast.For)
    turns.body += loop.body
    return wide

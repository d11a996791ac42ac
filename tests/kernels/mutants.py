"""Mutants of the reference: functions of which one operator, number, name or assignment is another."""

import ast
import copy
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import Any

_OTHER: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult},
    **{ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.USub: ast.UAdd, ast.Invert: ast.UAdd, ast.Not: ast.UAdd},
}
_NAMES = {"minimum": "maximum", "maximum": "minimum", "min": "max", "max": "min", "argmin": "argmax", "mean": "sum"}
_NAMES |= {"floor": "ceil", "rint": "floor", "any": "all", "all": "any", "zeros": "ones", "flatnonzero": "arange"}


@dataclass(frozen=True)
class Mutant:
    """A function of a module whose code has one change, which the name says."""

    function: FunctionType
    name: str
    code: CodeType

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Give the function this code while the block runs, wherever it was imported."""
        right, self.function.__code__ = self.function.__code__, self.code
        try:
            yield
        finally:
            self.function.__code__ = right


def mutants(module: ModuleType) -> Iterator[Mutant]:
    """Make all mutants of a module's functions and of the methods of its classes."""
    tree, file = ast.parse(inspect.getsource(module)), str(module.__file__)
    classes = [(node.body, getattr(module, node.name)) for node in tree.body if isinstance(node, ast.ClassDef)]
    for body, holder in [(tree.body, module), *classes]:
        for place, node in enumerate(body):
            if not isinstance(node, ast.FunctionDef) or node.decorator_list:
                continue
            function = vars(holder)[node.name]
            for name, changed in _changed(node):
                body[place] = changed
                code = compile(ast.fix_missing_locations(tree), file, "exec")
                yield Mutant(function, f"{function.__qualname__}: {name}", _codes(code)[function.__qualname__])
            body[place] = node


def _codes(code: CodeType) -> dict[str, CodeType]:
    """The code of all functions inside of another code, by their qualified names."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return {part.co_qualname: part for part in inner} | {k: v for part in inner for k, v in _codes(part).items()}


def _changed(function: ast.FunctionDef) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Copy the function with one change each; yield the first line of the statement that is changed, too."""
    for k, (_, node) in enumerate(_nodes(function)):
        for change in _CHANGES if function.name != "__init__" else _CHANGES[:3]:
            if change(copy.deepcopy(node)):
                other = copy.deepcopy(function)
                statement, changed = _nodes(other)[k]
                change(changed)
                yield ast.unparse(statement).partition("\n")[0], other


def _nodes(node: ast.AST) -> list[tuple[ast.stmt, Any]]:
    """All nodes inside of a statement, each with the innermost statement that it is in."""
    inside: list[tuple[ast.stmt, Any]] = []
    for child in ast.iter_child_nodes(node):
        annotation = child is getattr(node, "returns", None) or child is getattr(node, "annotation", None)
        if not annotation and not isinstance(child, ast.arguments):
            within = [(child if isinstance(child, ast.stmt) else node, child), *_nodes(child)]
            inside += [(owner if isinstance(owner, ast.stmt) else node, found) for owner, found in within]
    return inside


def _operator(node: Any) -> bool:
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _OTHER:
        node.ops[0] = _OTHER[type(node.ops[0])]()
    elif type(getattr(node, "op", None)) in _OTHER:
        node.op = _OTHER[type(node.op)]()
    else:
        return False
    return True


def _number(node: Any) -> bool:
    if not isinstance(node, ast.Constant) or type(node.value) not in (int, float):
        return False
    node.value = node.value + 1 if type(node.value) is int else 1.1 * node.value or 0.1
    return True


def _name(node: Any) -> bool:
    if not isinstance(node, ast.Attribute) or node.attr not in _NAMES:
        return False
    node.attr = _NAMES[node.attr]
    return True


def _kept(node: Any) -> bool:
    """Keep the first value that attributes of an object were set to."""
    targets = node.targets[0].elts if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple) else ()
    targets = targets or (node.targets[:1] if isinstance(node, ast.Assign) else ())
    if not targets or not all(isinstance(target, ast.Attribute) for target in targets):
        return False
    names = [f"{ast.unparse(target.value)}, {target.attr!r}" for target in targets]
    values = node.value.elts if len(targets) > 1 and isinstance(node.value, ast.Tuple) else [node.value]
    if len(values) != len(names):
        return False
    pairs = zip(names, values, strict=True)
    kept = [ast.parse(f"getattr({name}, {ast.unparse(value)})", mode="eval").body for name, value in pairs]
    node.value = kept[0] if len(kept) == 1 else ast.Tuple(kept, ast.Load())
    return True


def _added(node: Any) -> bool:
    """Add to the content of an array instead of replacing it."""
    if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Subscript):
        return False
    held = ast.parse(ast.unparse(node.targets[0]), mode="eval").body
    node.value = ast.BinOp(held, ast.Add(), node.value)
    return True


_CHANGES: tuple[Callable[[Any], bool], ...] = (_operator, _number, _name, _kept, _added)

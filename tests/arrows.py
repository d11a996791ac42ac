"""Who imports whom: the arrows between all files of lfgpu and kernels, from their imports, and a drawing of them.

    python tests/arrows.py      # writes docs/arrows.svg; prints lines of rooms and of the longest files

An import counts wherever it stands: at the top, in a function, or for type checkers only. A room is a folder of
`lfgpu`, or a file that lies directly in it.
"""

import ast
from collections.abc import Iterator
from functools import cache
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
DRAWING = ROOT / "docs" / "arrows.svg"

FLOORS = (
    ("cli",),
    ("batch", "viewer", "training"),
    ("reports",),
    ("viz", "calibration"),
    ("pipelines",),
    ("io", "comparison", "cameras"),
    ("methods", "scenes", "metrics"),
    ("data", "solvers", "kernels"),
    ("_backends",),
    ("contract", "config", "threads", "machine"),
    ("vulkan",),
    ("errors",),
    ("printable", "hooks"),
)
"""The rooms, from the top floor down. An arrow leads to the same floor or down, never up and never in a circle."""

_TOP = ("__init__", "__main__")  # they list the public names and start the command line: above all floors


@cache
def files() -> dict[str, Path]:
    """All files of the package by the name of their module."""
    found = {}
    for folder, package in ((ROOT / "lfgpu", "lfgpu"), (ROOT / "kernels", "lfgpu.kernels")):
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *(part for part in parts if part != "__init__")))] = path
    return found


def room(module: str) -> str:
    """The room that a module is in; "__init__" for the package itself."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


@cache
def imported(module: str) -> tuple[tuple[str, str], ...]:
    """(module, name) of all that a module imports from lfgpu; the name is "" where a module is imported whole."""
    return tuple(_imported(module))


def _imported(module: str) -> Iterator[tuple[str, str]]:
    known, path = files(), files()[module]
    parts = module.split(".") if path.name != "__init__.py" else [*module.split("."), ""]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            base = (
                ".".join([*parts[: len(parts) - node.level], *filter(None, [node.module])])
                if node.level
                else node.module
            )
            for alias in node.names:
                if f"{base}.{alias.name}" in known:
                    yield f"{base}.{alias.name}", ""
                elif base in known:
                    yield str(base), alias.name


@cache
def arrows() -> dict[str, set[str]]:
    """The modules that each module imports; those of the package's own front page are left out."""
    return {
        module: {target for target, _ in imported(module) if target != module}
        for module in files()
        if room(module) not in _TOP
    }


def between_rooms() -> dict[str, set[str]]:
    """The rooms that each room imports from."""
    found: dict[str, set[str]] = {name: set() for floor in FLOORS for name in floor}
    for module, targets in arrows().items():
        found.setdefault(room(module), set()).update(room(target) for target in targets)
    return {name: targets - {name} for name, targets in found.items()}


def circles() -> list[list[str]]:
    """Groups of modules that import each other, directly or through others (Tarjan 1972)."""
    graph, index, low, stack, found = arrows(), {}, {}, [], []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for target in sorted(graph.get(module, ())):
            if target not in index:
                visit(target)
                low[module] = min(low[module], low[target])
            elif target in stack:
                low[module] = min(low[module], index[target])
        if low[module] == index[module]:
            group = []
            while not group or group[-1] != module:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for module in graph:
        if module not in index:
            visit(module)
    return found


def implied(graph: dict[str, set[str]], name: str, target: str) -> bool:
    """True if a room reaches another one through a third one as well."""
    reached, left = set[str](), list(graph[name] - {target})
    while left:
        place = left.pop()
        if place not in reached:
            reached.add(place)
            left += graph.get(place, ())
    return target in reached


def lines(name: str) -> int:
    """Lines of code in a room."""
    return sum(len(path.read_text().splitlines()) for module, path in files().items() if room(module) == name)


def drawing() -> str:
    """The rooms on their floors as SVG. An arrow is left out where others lead to the same room."""
    width, wide, tall, pitch = 960, 150, 34, 92
    places = {
        name: (width * (k + 0.5) / len(floor), 24 + level * pitch)
        for level, floor in enumerate(FLOORS)
        for k, name in enumerate(floor)
    }
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {len(FLOORS) * pitch}"'
        ' font-family="sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#57606a"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    graph = between_rooms()
    for name, targets in sorted(graph.items()):
        for target in sorted(target for target in targets if not implied(graph, name, target)):
            (x0, y0), (x1, y1) = places[name], places[target]
            lean = (x1 - x0) / width
            if y0 == y1:
                side = wide / 2 if x1 > x0 else -wide / 2
                ends = x0 + side, y0 + tall / 2, x1 - side, y1 + tall / 2
            else:
                ends = x0 + lean * wide / 2, y0 + tall, x1 - lean * wide / 2, y1
            path = "M{:.0f} {:.0f}L{:.0f} {:.0f}".format(*ends)
            out.append(f'<path d="{path}" stroke="#8c959f" fill="none" marker-end="url(#tip)"/>')
    for name, (x, y) in places.items():
        box = f'x="{x - wide / 2:.0f}" y="{y}" width="{wide}" height="{tall}" rx="6"'
        out.append(f'<rect {box} fill="#ddf4ff" stroke="#0969da"/>')
        out.append(f'<text x="{x:.0f}" y="{y + 22}" text-anchor="middle" font-size="15">{escape(name)}</text>')
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    DRAWING.write_text(drawing(), encoding="utf-8")
    for name in between_rooms():
        print(f"{lines(name):6d} lines in {name}")
    for module, path in sorted(files().items(), key=lambda item: -len(item[1].read_text().splitlines()))[:10]:
        print(f"{len(path.read_text().splitlines()):6d} lines in {module}")

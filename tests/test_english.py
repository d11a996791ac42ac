"""The English of docstrings: a class or a module begins with a noun, a function with a verb, none with a question."""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

QUESTIONS = frozenset(
    {"What", "Whether", "Which", "How", "Where", "When", "Why", "Who", "Whom", "Whose"}
    | {"That", "This", "These", "Those", "There", "It", "They", "He", "She"}
)
"""Words that no docstring begins with: they ask, or stand for a noun of another sentence."""

NO_VERBS = frozenset({"The", "A", "An", "All", "Each", "One", "Every", "Its", "LightFieldError", "LfgpuError"})
"""Words with which a noun begins. Properties and attributes may begin so, functions not."""

Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def documented(nodes: list[ast.AST]) -> Iterator[tuple[Documented, str]]:
    """Yield what has a docstring in a file, with the first word of it."""
    for node in nodes:
        if isinstance(node, Documented) and (text := ast.get_docstring(node)):
            yield node, re.sub(r"\W+$", "", text.split()[0])


def said_beside(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Yield line and first word of the docstrings of attributes, and of help texts of the command line."""
    for node in nodes:
        if isinstance(node, ast.keyword) and node.arg == "help" and isinstance(node.value, ast.Constant):
            yield node.value.lineno, str(node.value.value).split(" ")[0]
        if isinstance(node, ast.Module | ast.ClassDef):
            for before, after in pairwise(node.body):
                text = ast.unparse(after.value)[1:-1].strip() if isinstance(after, ast.Expr) else ""
                if isinstance(before, ast.Assign | ast.AnnAssign) and text:
                    yield after.lineno, text.split()[0]


def is_property(node: Documented) -> bool:
    """Tell whether a function is read as an attribute."""
    names = {ast.unparse(decorator) for decorator in getattr(node, "decorator_list", ())}
    return bool(names & {"property", "cached_property", "functools.cached_property"})


def wrong(path: Path) -> list[str]:
    """List the docstrings, attributes' among them, and help texts of a file that begin as they must not."""
    found, nodes = [], list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    for node, word in documented(nodes):
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(node)
        if word in QUESTIONS or (is_function and word in NO_VERBS):
            name = getattr(node, "name", "the module")
            found.append(f"{path.name}:{getattr(node, 'lineno', 1)}: {name} begins with {word!r}")
    return found + [f"{path.name}:{line}: {word}" for line, word in said_beside(nodes) if word in QUESTIONS]


def all_sources() -> Iterator[Path]:
    """Yield all files of the package and of the benchmarks."""
    for folder in ("lfgpu", "kernels", "benchmarks"):
        yield from sorted((ROOT / folder).rglob("*.py"))


def test_docstrings_attributes_and_help_texts_begin_as_they_should() -> None:
    found = [sentence for path in all_sources() for sentence in wrong(path)]
    assert found == [], "see CONTRIBUTING.md, What a change needs"


@pytest.mark.parametrize(
    ("code", "count"),
    [
        ('"""What a file holds."""', 1),
        ('"""Contents of a file."""\n\n\nclass A:\n    """That of a file."""\n', 1),
        ('def f():\n    """The sum."""\n', 1),
        ('def f():\n    """Sum the costs. What is left is NaN."""\n', 0),
        ('class A:\n    @property\n    def f(self):\n        """The sum."""\n', 0),
        ('class A:\n    @property\n    def f(self):\n        """Whether it is."""\n', 1),
        ('async def f():\n    """LightFieldError: always."""\n', 1),
    ],
)
def test_what_is_wrong_is_found(code: str, count: int, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(code, encoding="utf-8")
    assert len(wrong(tmp_path / "a.py")) == count


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
ELLIPSES = re.compile(
    r"\b(?:is|are) what\b|(?<=[.:|] )What (?:is|lies|fails|it)\b"
    r"|\bdoes without\b|\bdo(?:es)? so\b|\bwhat is (?:left|behind|nearer)\b"
)
"""Words of sentences in which a thing has no name, or a verb is left out."""


@pytest.mark.parametrize("page", [p for p in PAGES if "made" not in p.parts], ids=lambda page: page.name)
def test_pages_name_things(page: Path) -> None:
    found = [
        (number, words[0])
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for words in ELLIPSES.finditer(line)
    ]
    assert not found

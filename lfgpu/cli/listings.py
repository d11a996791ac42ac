"""Lists of presets, formats and the like for help texts, taken from the registries when help is shown.

A help text names a list in braces, such as `{formats}`. A new row of a registry appears in the help by itself, and
commands load no registry to say what they do.
"""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand

EXAMPLE = "Example: "
"""Beginning of the epilog of a command; the rest of it is the example."""


_RANGES = ("--disparity-range", "--depths")


class Command(TyperCommand):
    """A command whose help texts may name lists, and whose example stands in the list of all commands."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        paragraphs = [" ".join(paragraph.split()) for paragraph in (self.help or "").split("\n\n")]
        self.help, self.summary = "\n\n".join(paragraphs), paragraphs[0]
        # What stands in the list of all commands; \b keeps the line break.
        self.short_help = f"\b\n{self.summary}\n$ {(self.epilog or '').removeprefix(EXAMPLE)}"

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return the summary, for the shell's completion; Click's own would cut it off after `limit` characters."""
        return self.summary

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments, none of them empty; a range may be two numbers, "-2 2", where its option takes "-2,2"."""
        if not ctx.resilient_parsing:
            self._check_none_is_empty(ctx, args)
        joined = list(args)
        for place, name in enumerate(args):
            pair = args[place + 1 : place + 3]
            if name in _RANGES and len(pair) == 2 and all(map(_is_number, pair)):
                joined[place + 1 : place + 3] = [",".join(pair)]
                break
        return super().parse_args(ctx, joined)

    def _check_none_is_empty(self, ctx: Any, args: list[str]) -> None:
        """Refuse empty words, such as of a variable that is not set: as a path they mean the current folder."""
        may_be = {name for parameter in self.params if parameter.default == "" for name in parameter.opts}
        for before, word in zip(["", *args], args, strict=False):
            name = before if before.startswith("-") else ""
            if word.startswith("--") and word.endswith("="):
                name, word = word[:-1], ""
            if not word and name not in may_be:
                hint = name if name.strip("-") else "an argument"
                raise typer.BadParameter("it is empty, as a variable is that is not set.", ctx=ctx, param_hint=hint)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Put the lists into the help texts, then show them."""
        for parameter in self.params:
            if getattr(parameter, "help", None):
                parameter.help = filled(parameter.help)  # type: ignore[attr-defined]  # options and arguments have one
        super().format_help(ctx, formatter)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def filled(text: str) -> str:
    """Put the lists in place of their names in a help text."""
    for name, listed in _LISTS.items():
        if name in text:
            text = text.replace(name, listed())
    return text


def _presets() -> str:
    from lfgpu.methods import METHODS

    return "; ".join(f"{name}: {entry.labels[name]}" for entry in METHODS.values() for name in entry.presets)


def _presets_that(fact: str) -> str:
    """List the presets whose method has a fact, such as "is_live"."""
    from lfgpu.methods import PRESETS, method_of

    return ", ".join(name for name in PRESETS if getattr(method_of(name), fact))


def _sources() -> str:
    from lfgpu.pipelines.sources import SOURCES

    return "; ".join(f"{source.form}: {source.description}" for source in SOURCES)


def _formats() -> str:
    from lfgpu.io.formats import FORMATS

    return ", ".join(entry.name for entry in FORMATS)


def _backends() -> str:
    from lfgpu._backends import list_backends

    return ", ".join(list_backends())


_LISTS: dict[str, Callable[[], str]] = {
    "{presets}": _presets,
    "{live presets}": lambda: _presets_that("is_live"),
    "{recordable presets}": lambda: _presets_that("is_recordable"),
    "{formats}": _formats,
    "{sources}": _sources,
    "{backends}": _backends,
}

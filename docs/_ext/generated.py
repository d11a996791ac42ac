"""Pages that are made when the site is built: files beside docs/, the commands with their options."""

from __future__ import annotations

from typing import Any

import outside
import typer
from sphinx.application import Sphinx

from lfgpu.cli import app as commands
from lfgpu.cli.listings import EXAMPLE, filled

MADE = outside.DOCS / "made"

_COMMANDS = """\
# Commands

Every command of `lfgpu`, with its options. `lfgpu COMMAND --help` says the same. Wrong usage ends with exit code 2, an
error with exit code 1 and one sentence on stderr, Ctrl-C with 130.

`lfgpu --install-completion` teaches your shell (bash, zsh, fish, PowerShell) to complete commands and options with the
Tab key; open a new terminal afterwards.
"""


def write(app: Sphinx) -> None:
    """Write all of them; one that did not change keeps its time, so that it is not read again."""
    MADE.mkdir(exist_ok=True)
    for name, page in outside.PAGES.items():
        source, target = outside.ROOT / name, MADE / f"{page}.md"
        _put(target.name, outside.led(source.read_text(encoding="utf-8"), source, target))
    _put("commands.md", _commands())


def _put(name: str, text: str) -> None:
    path = MADE / name
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _commands() -> str:
    group = typer.main.get_command(commands)
    tasks: dict[str, list[Any]] = {}
    for command in group.commands.values():  # type: ignore[attr-defined]
        tasks.setdefault(command.rich_help_panel, []).append(command)
    parts = [_COMMANDS]
    for task, members in tasks.items():
        parts.append(f"## {task}\n")
        parts += [_command(command) for command in members]
    return "\n".join(parts)


def _command(command: Any) -> str:
    names = [p.metavar for p in command.params if p.param_type_name == "argument"]
    rows = [_parameter(p) for p in command.params if not getattr(p, "hidden", False)]
    return "\n".join(
        [
            f"### lfgpu {command.name}\n",
            f"{_escaped(filled(command.help))}\n",
            f"```sh\nlfgpu {' '.join([command.name, *filter(None, names), '[OPTIONS]'])}\n```\n",
            f"{EXAMPLE}`{command.epilog.removeprefix(EXAMPLE)}`\n",
            *rows,
            "",
        ]
    )


def _parameter(parameter: Any) -> str:
    """An entry of a definition list."""
    name = parameter.metavar or parameter.name
    if parameter.param_type_name == "option":
        value = "" if parameter.is_flag else f" {parameter.metavar or parameter.name.upper()}"
        name = ", ".join(f"{option}" for option in parameter.opts) + value
    shown = parameter.show_default if isinstance(parameter.show_default, str) else None
    default = shown or (None if parameter.default in (None, False, "", ()) else str(parameter.default))
    said = _escaped(filled(parameter.help or ""))
    return f"`{name}`\n: {said}{f' Default: {default}.' if default and not parameter.required else ''}\n"


def _escaped(text: str) -> str:
    return text.replace("<", r"\<").replace("*", r"\*")


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the pages before any is read."""
    app.connect("builder-inited", write, priority=100)  # before summaries and gallery are made
    return {"parallel_read_safe": True, "parallel_write_safe": True}

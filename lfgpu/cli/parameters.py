"""`lfgpu parameters`: what `--set` can change."""

from __future__ import annotations

from dataclasses import Field, dataclass, fields
from typing import TYPE_CHECKING, Any

import typer

from lfgpu.cli.options import Preset

if TYPE_CHECKING:
    from rich.console import Console

    from lfgpu.config import Config

_ALLOWED = 12  # characters of a range or of choices in a line


@dataclass(frozen=True)
class Row:
    """One parameter as text."""

    name: str  # `stage.parameter`, as `--set` takes it
    value: str  # the value in the preset
    allowed: str  # the range or the choices
    meaning: str  # the meaning, with the unit
    symbol: str  # its symbol in the paper; "" if it has none


def parameters(preset: Preset = "surest") -> None:
    """List the parameters that --set changes.

    Shows the name, the value in the preset, the range or choices, the meaning, and the symbol in the paper. A terminal
    gets a table. A pipe gets one line for each parameter, with tabs between these five.
    """
    from lfgpu.cli.console import output
    from lfgpu.methods import METHODS, preset as preset_of

    config = preset_of(preset)
    console = output()
    if not console.is_terminal:
        for row in rows(config):
            typer.echo("\t".join((row.name, row.value, row.allowed, row.meaning, row.symbol)))
        return
    entry = METHODS[config.method]
    title = f"{preset}: {entry.labels[preset]}. The method {config.method} {entry.label}."
    _show(console, title, config)


def rows(config: Config) -> list[Row]:
    """Return all parameters of a configuration, in order."""
    from lfgpu.config import parameters as fields_of, value_of

    found = []
    for name, field in fields_of(config):
        value, about = value_of(config, name), field.metadata
        text = value if isinstance(value, str) else f"{value:g}"
        found.append(Row(name, text, allowed(field), about["doc"], about["symbol"]))
    return found


def allowed(field: Field[Any]) -> str:
    """Return the range or the choices of a parameter: "once, twice", "0 to 1" or "3 to 31, odd"."""
    about = field.metadata
    if "choices" in about:
        return ", ".join(about["choices"])
    kind = ", odd" if about["odd"] else ", integer" if isinstance(field.default, int) else ""
    return f"{about['low']:g} to {about['high']:g}{kind}"


def _show(console: Console, title: str, config: Config) -> None:
    """Print a table for each section of parameters; all tables have the same columns."""
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    from lfgpu.cli.console import heading, remark

    found = rows(config)
    heading(console, title)
    for section in fields(config):
        about = (getattr(config, section.name).__doc__ or "").split("\n")[0].rstrip(".")
        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(no_wrap=True, min_width=max(len(row.name) for row in found))
        table.add_column(no_wrap=True, min_width=max(len(row.value) for row in found))
        table.add_column(overflow="fold", width=_ALLOWED)
        table.add_column(overflow="fold")
        for row in found:
            if row.name.startswith(f"{section.name}."):
                symbol = f" [{row.symbol}]" if row.symbol else ""
                table.add_row(row.name, row.value, row.allowed, row.meaning + symbol)
        console.print()
        console.print(Text.assemble((section.name, "bold cyan"), f": {about}"))
        console.print(Padding(table, (0, 0, 0, 2), expand=False))
    remark(console, "Change a parameter with --set NAME=VALUE. In square brackets: its symbol in the paper.")

"""The command line: `python -m benchmarks` measures, and each name of a command is another benchmark."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import typer

from benchmarks import suite
from lfgpu.cli.failures import Group

app = typer.Typer(
    name="benchmarks",
    cls=Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_MODULES = {"accuracy": "population", "range": "measuring", "table": "runs"}
"""The modules of commands that are not named like theirs."""

COMMANDS: dict[str, Callable[..., None]] = {
    name: import_module(f"benchmarks.{_MODULES.get(name, name.replace('-', '_'))}").command
    for names in (
        "accuracy ablation confidence like paper rendering tile-differences",  # errors of maps
        "misalignment judge rectify",  # cameras
        "range scaling batches tiles",  # many light fields, and large ones
        "live flicker soak",  # streams
        "call pairs network choice windows",  # parts of an estimate, and training of one
        "table compare figures gpu-parity",  # files of results, and pages
    )
    for name in names.split()
}

app.callback(invoke_without_command=True)(suite.measure)
for _name, _function in COMMANDS.items():
    app.command(_name)(_function)


def main() -> None:
    """Run and exit: 0 for done, 1 for an error or a finding, 2 for wrong usage, 130 for interrupted."""
    app(prog_name="python -m benchmarks")

"""The command line: `python -m benchmarks` measures, and each name of a command is another benchmark."""

from __future__ import annotations

from collections.abc import Callable

import typer

from benchmarks import (
    ablation,
    batches,
    compare,
    confidence,
    figures,
    flicker,
    gallery,
    gpu_parity,
    judge,
    live,
    measuring,
    misalignment,
    network,
    paper,
    population,
    rectify,
    rendering,
    runs,
    scaling,
    soak,
    suite,
    tile_differences,
    tiles,
)
from lfgpu.cli.failures import Group

app = typer.Typer(
    name="benchmarks",
    cls=Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

COMMANDS: dict[str, Callable[..., None]] = {
    # errors of maps
    "accuracy": population.command,
    "ablation": ablation.command,
    "confidence": confidence.command,
    "paper": paper.command,
    "rendering": rendering.command,
    "tile-differences": tile_differences.command,
    # cameras
    "misalignment": misalignment.command,
    "judge": judge.command,
    "rectify": rectify.command,
    # many light fields, and large ones
    "range": measuring.command,
    "scaling": scaling.command,
    "batches": batches.command,
    "tiles": tiles.command,
    # streams
    "live": live.command,
    "flicker": flicker.command,
    "soak": soak.command,
    # parts of an estimate
    "network": network.command,
    # files of results, and pages
    "table": runs.command,
    "compare": compare.command,
    "figures": figures.command,
    "gallery": gallery.command,
    "gpu-parity": gpu_parity.command,
}

app.callback(invoke_without_command=True)(suite.measure)
for _name, _function in COMMANDS.items():
    app.command(_name)(_function)


def main() -> None:
    """Run and exit: 0 for done, 1 for an error or a finding, 2 for wrong usage, 130 for interrupted."""
    app(prog_name="python -m benchmarks")

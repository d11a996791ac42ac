"""The command line: `python -m benchmarks [options]` measures; `table`, `plot` and `compare` look at what was found.

`accuracy` scores a population of light fields, `ablation` leaves ingredients out, `rendering` renders views that were
left out, `misalignment` lines up cameras that were moved, `judge` looks for a single view that was moved, `live`,
`rectify`, `ring`, `flicker`, `drift` and `soak` are about streams, `scaling` takes several GPUs, `tiles` limits the
memory, `viewer` asks for pictures as pages do, `gallery` draws the picture of the site's first page, `figures` writes
the figures of all pages from the committed results.
"""

from __future__ import annotations

from collections.abc import Callable

import typer

from benchmarks.cli import accuracy, cameras, measure, streams, written
from lfgpu.cli.failures import Group

app = typer.Typer(
    name="benchmarks",
    cls=Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_COMMANDS: dict[str, Callable[..., None]] = {
    "ablation": accuracy.ablation_,
    "accuracy": accuracy.accuracy_,
    "confidence": accuracy.confidence_,
    "rendering": accuracy.rendering_,
    "files": accuracy.files_,
    "flicker": streams.flicker_,
    "live": streams.live_,
    "ring": streams.ring_,
    "misalignment": cameras.misalignment_,
    "judge": cameras.judge_,
    "rectify": cameras.rectify_,
    "range": measure.range_,
    "soak": streams.soak_,
    "native": streams.native_,
    "drift": streams.drift_,
    "scaling": measure.scaling_,
    "batches": measure.batches_,
    "tiles": measure.tiles_,
    "viewer": measure.viewer_,
    "tile-differences": accuracy.tile_differences_,
    "table": written.table,
    "plot": written.plot_,
    "compare": written.compare_,
    "gallery": written.gallery_,
    "gpu-parity": measure.gpu_parity_,
    "paper": accuracy.paper_,
    "figures": written.figures_,
}

app.callback(invoke_without_command=True)(measure.measure)
for _name, _function in _COMMANDS.items():
    app.command(_name)(_function)


def main() -> None:
    """Run and exit: 0 for done, 1 for an error or a finding of `compare`, 2 for wrong usage, 130 for interrupted."""
    app(prog_name="python -m benchmarks")

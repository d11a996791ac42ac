"""Training of the network of windows around a map, for a release whose network of whole ranges has changed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.errors import BenchmarkError
from benchmarks.options import DeviceName, Side, say
from lfgpu._backends import DEFAULT
from lfgpu.cli.batch import devices_of
from lfgpu.methods.matching.learned import weights_of_windows

_RATE = 1e-3  # training begins with the weights that lfgpu comes with
_UNSEEN = 16  # batches of the validation
_SHOWN = 200  # steps from one line to the next


def command(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.npz", help="File of the weights.")],
    minutes: Annotated[float, typer.Option(min=0, help="Time for training, at most.")] = 10,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the whole run.")] = 4500,
    batch: Annotated[int, typer.Option(min=1, metavar="N", help="Light fields of a step, on each device.")] = 8,
    side: Side = 192,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    device: DeviceName = None,
) -> None:
    """Train the network of wide ranges, which improves a map that is known roughly (needs PyTorch)."""
    if find_spec("torch") is None:
        raise BenchmarkError("training needs PyTorch, which is not installed; install lfgpu[train].")
    from lfgpu.training.compared import Windows
    from lfgpu.training.run import run
    from lfgpu.training.train import Settings

    settings = Settings(steps, scenes=batch, side=side, rate=_RATE, seed=seed, unseen=_UNSEEN)
    done, found = run(
        settings,
        out.with_name(f"{out.name}.training"),
        out,
        devices=devices_of(DEFAULT, device),
        seconds=60 * minutes,
        start=weights_of_windows(),
        compared=Windows,
        on_step=lambda step, line: say(f"{line}") if step % _SHOWN == 0 else None,
    )
    say(f"{done} steps; on other light fields: {found.errors}")

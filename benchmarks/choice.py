"""Training of the choice of the preset surest, for a release whose network or sweeps have changed."""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.errors import BenchmarkError
from benchmarks.options import DeviceName, say
from lfgpu._backends import DEFAULT, open_device
from lfgpu.methods.matching import learned
from lfgpu.methods.matching.choice import read_choice


def command(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.npz", help="File of the weights.")],
    light_fields: Annotated[int, typer.Option(min=1, metavar="N", help="Light fields to learn from.")] = 11424,
    side: Annotated[int, typer.Option(min=32, help="Pixels of these, each way.")] = 256,
    steps: Annotated[int, typer.Option(min=1)] = 9000,
    start: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Weights to begin with. Default: new ones.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    device: DeviceName = None,
) -> None:
    """Generate light fields, match them twice, and train the choice between the two maps (needs PyTorch)."""
    if find_spec("torch") is None:
        raise BenchmarkError("training needs PyTorch, which is not installed; install lfgpu[train].")
    from benchmarks.choosing import draw, train_choice
    from lfgpu.training.weights import write_weights

    began, place = time.monotonic(), open_device(DEFAULT, device).name

    def shown(done: int, said: str = "light fields") -> None:
        if done % 100 == 0:
            say(f"{done} {said}, {time.monotonic() - began:.0f} s")

    weights, first = learned.weights_file(learned.BUILT_IN), None if start is None else read_choice(start)
    seen = draw(light_fields, seed=seed, device=place, side=side, weights=weights, on_light_field=shown)
    network = train_choice(
        seen,
        steps=steps,
        seed=seed,
        start=first,
        on_step=lambda step, loss: shown(step, f"steps, loss {float(loss):.3f}"),
    )
    write_weights(out, network.state_dict())

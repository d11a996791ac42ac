"""`lfgpu train`: weights for the preset learned, from generated light fields."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfgpu._backends import DEFAULT
from lfgpu.cli.batch import devices_of
from lfgpu.cli.options import Quiet, ReadingIncomplete
from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from lfgpu.training.rig import Rig

_STEPS, _STEPS_LIKE = 13_000, 4_000
_UNSEEN = 32  # batches of a validation, at most


def train(
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="FILE", help="File of weights, .npz. The folder FILE.training keeps the run."
        ),
    ],
    like: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="INPUT",
            help="Light field of the cameras to fit the weights to; may be repeated.",
            show_default="cameras of all kinds, from random weights",
        ),
    ] = None,
    *,
    minutes: Annotated[float, typer.Option(min=0, help="Time for training; the same command goes on later.")] = 25,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help="Steps of the whole run.", show_default=f"{_STEPS}; with --like {_STEPS_LIKE}"),
    ] = None,
    batch: Annotated[int, typer.Option(min=2, metavar="N", help="Light fields of a step, on each device.")] = 8,
    side: Annotated[
        int | None,
        typer.Option(
            metavar="PIXELS", help="Side of these light fields, a multiple of 32.", show_default="192, or the views'"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all that is drawn.")] = 0,
    device: Annotated[
        str | None, typer.Option(metavar="DEVICE", help="cpu, cuda or cuda:1.", show_default="all GPUs, else the CPU")
    ] = None,
    reading: ReadingIncomplete,
    quiet: Quiet = False,
) -> None:
    """Train the network of the preset learned on generated light fields, or fit it to your cameras.

    With --like, positions of the cameras, range of disparities, noise and brightness are measured, and training begins
    with the weights of lfgpu. Nothing of the light fields themselves is learned. The weights are written after each
    piece of the run; use them with --weights. On a GPU a step takes about 0.1 s, on a CPU a minute.
    """
    from lfgpu.cli.console import heading, lines, output, waiting
    from lfgpu.io import check_writable, read
    from lfgpu.io.damage import require
    from lfgpu.methods.matching.learned import BUILT_IN, read_weights

    if out.suffix != ".npz":
        raise LightFieldError(f"{out} must end in .npz, as a file of weights does.")
    check_writable(out, folder=False)
    if side is not None and (side < 32 or side % 32):
        raise LightFieldError(f"--side must be a multiple of 32, not {side}.")
    require("torch", "train", "lfgpu train")
    options = reading.options()
    devices = devices_of(DEFAULT, device)

    import torch

    from lfgpu.training.rig import measured_rig
    from lfgpu.training.run import PICTURE_FILE, run
    from lfgpu.training.train import LOG_FILE, RATE, RATE_LIKE, Settings

    if devices[0] != "cpu" and not torch.cuda.is_available():
        raise LightFieldError("this PyTorch has no CUDA; install one that has, or give --device cpu.")
    rig, most = None, 192
    if like:
        rig = measured_rig([read(path, **options) for path in like], backend=DEFAULT, device=devices[0])
        most = min(most, max(min(rig.size) // 32 * 32, 32))
        if not quiet:
            heading(output(), "Cameras that the weights are fitted to")
            lines(output(), _facts(rig))
    how = Settings(
        steps or (_STEPS_LIKE if like else _STEPS),
        scenes=batch,
        side=side or most,
        rate=RATE_LIKE if like else RATE,
        unseen=min(steps or _UNSEEN, _UNSEEN),
        seed=seed,
    )
    folder = out.with_suffix(".training")
    with waiting(quiet=quiet, counts=True) as show:
        done, found = run(
            how,
            folder,
            out,
            devices=devices,
            seconds=60 * minutes,
            rig=rig,
            start=None if rig is None else read_weights(BUILT_IN),
            on_step=lambda step, line: show(_said(line), step, how.steps),
        )
    if quiet:
        return
    bad = ", ".join(f"{100 * found.errors[f'bad {limit}']:.1f} %" for limit in ("0.28", "0.12", "0.04"))
    heading(output(), f"{done} of {how.steps} steps" + ("" if done == how.steps else ": the same command goes on"))
    lines(
        output(),
        [
            ("unseen", f"{bad} of the pixels of unseen light fields are off by more than 0.28, 0.12, 0.04 px"),
            ("", "in the farthest view"),
            (out.name, "the weights: lfgpu depth ... --weights " + str(out)),
            (f"{folder.name}/", f"the state of the run, {LOG_FILE}, {PICTURE_FILE}"),
        ],
    )


def _facts(rig: Rig) -> list[tuple[str, str]]:
    low, high = rig.limits
    return [
        ("views", ", ".join(str(len(array) + 1) for array in rig.arrays)),
        ("disparities", f"{low:.1f} to {high:.1f} px in the farthest view"),
        ("noise", f"{rig.grain:.4f}, intensity"),
        ("brightness", f"{rig.level:.2f}, mean intensity{', grey' if rig.is_grey else ''}"),
    ]


def _said(line: dict[str, Any]) -> str:
    """Write the last line of the log for the display."""
    return f"loss {line['loss']:.3f}, {100 * line['bad 0.28']:.1f} % bad, {line['ms']} ms a step" if line else ""

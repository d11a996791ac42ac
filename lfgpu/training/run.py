"""A piece of a training run, from its folder to the file of weights, on one or several devices."""

from __future__ import annotations

import multiprocessing
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist

from lfgpu.io import atomic_write
from lfgpu.methods.matching.unet import Weights
from lfgpu.threads import on_signal
from lfgpu.training.compared import Comparison, WholeRanges
from lfgpu.training.rig import Rig
from lfgpu.training.train import Settings, Trainer, Validation
from lfgpu.training.weights import write_weights
from lfgpu.viz.sheets import comparison

PICTURE_FILE = "validation.png"

_PATIENCE = timedelta(minutes=5)  # until a process that hears nothing from the others gives up


def run(
    settings: Settings,
    folder: Path,
    out: Path,
    *,
    devices: Sequence[str],
    seconds: float,
    rig: Rig | None = None,
    start: Weights | None = None,
    compared: type[Comparison] = WholeRanges,
    on_step: Callable[[int, dict[str, Any]], None] | None = None,
) -> tuple[int, Validation]:
    """Train for some time, or to the end, validate, and write the weights.

    A run that is in `folder` already goes on. Ctrl-C ends the piece as its time does.

    Parameters
    ----------
    settings, folder, rig, start, compared
        As for `Trainer`; the folder also gets a picture of the validation.
    out
        The file of weights, .npz.
    devices
        A process each, such as ("cuda:0", "cuda:1").
    seconds
        The time for training.
    on_step
        As for `Trainer.run`.

    Returns
    -------
    int, Validation
        The number of steps that are done, and the errors.
    """
    several: dict[str, Any] = {"rig": rig, "start": start, "compared": compared, "world": len(devices)}
    with tempfile.TemporaryDirectory() as place:
        meeting = f"file://{place}/meeting"
        others = [
            multiprocessing.get_context("spawn").Process(
                target=_follow, args=(settings, folder, device, rank, meeting, seconds, several), daemon=True
            )
            for rank, device in enumerate(devices)
            if rank > 0
        ]
        for process in others:
            process.start()
        with _together(devices[0], 0, len(devices), meeting):
            trainer = Trainer(settings, folder, devices[0], **several)
            with on_signal(signal.SIGINT, lambda *_: setattr(trainer, "stopped", True)):  # after a whole step
                trainer.run(seconds, on_step)
        for process in others:
            process.join()
    found = trainer.validate()
    trainer.note({"step": trainer.step, "unseen": found.errors})
    write_weights(out, trainer.mean.state_dict(), share=found.share, spread=found.spread)
    with atomic_write(folder / PICTURE_FILE) as path:
        comparison(found.shown).save(path)
    return trainer.step, found


def _follow(
    settings: Settings, folder: Path, device: str, rank: int, meeting: str, seconds: float, several: dict[str, Any]
) -> None:
    """Do the work of a process beside the first one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first one hears it
    with _together(device, rank, several["world"], meeting):
        Trainer(settings, folder, device, rank=rank, **several).run(seconds)


@contextmanager
def _together(device: str, rank: int, world: int, meeting: str) -> Iterator[None]:
    """Join the processes of a run."""
    if device != "cpu":
        torch.cuda.set_device(device)
    if world == 1:
        yield
        return
    dist.init_process_group(
        "gloo" if device == "cpu" else "nccl", init_method=meeting, rank=rank, world_size=world, timeout=_PATIENCE
    )
    try:
        yield
    finally:
        dist.destroy_process_group()

"""The gain of weights that are fitted to a rig (`lfgpu train --like`), on scenes that the fit never saw."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from benchmarks import population, runs
from benchmarks.options import DeviceName, Out, Side, check_out, say
from benchmarks.results import Record, Run
from benchmarks.tables import Table
from lfgpu import LightField, scenes
from lfgpu._backends import DEFAULT, open_device
from lfgpu.calibration.misalign import displacements
from lfgpu.data import GroundTruth
from lfgpu.methods import configured
from lfgpu.methods.matching.learned import BUILT_IN, read_weights

if TYPE_CHECKING:
    from lfgpu.training.generator import Generator

_RIGS = {"row of 5": ((1, 5), 0.0), "12 scattered": ((3, 4), 0.3)}
"""Grids, and by how many view steps the cameras are off it (standard deviation)."""

_SHOWN, _UNSEEN = ("boxes", "planes"), ("boxes", "planes", "bars", "textureless", "still_life")
_RANGE, _NOISE = (-1.2, 2.0), 0.01
_WEIGHTS, _PACKAGE = ("shipped", "fitted"), "package"
_GENERATED, _SEED = 16, 77  # light fields of the generator, and their seed, which no training has


def command(
    minutes: Annotated[float, typer.Option(min=0, help="Time for the training of each rig.")] = 2.5,
    steps: Annotated[int, typer.Option(min=1)] = 1800,
    side: Side = 192,
    batch: Annotated[int, typer.Option(min=2, help="Light fields of a step.")] = 8,
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Fit weights to a row of 5 and to 12 scattered cameras, and score them against those of lfgpu on unseen scenes."""
    from lfgpu.training.generator import Generator
    from lfgpu.training.rig import measured_rig
    from lfgpu.training.run import run
    from lfgpu.training.train import RATE_LIKE, Settings

    check_out(out)
    place, begun = open_device(DEFAULT, device).name, Run.begun("like")
    before: list[Record] = []
    after: list[Record] = []
    for name, (grid, off) in _RIGS.items():
        made = partial(_scene, grid=grid, off=off, size=(side, side * 4 // 3))
        rig = measured_rig([made(scene, 1) for scene in _SHOWN], backend=DEFAULT, device=place)
        how = Settings(steps, scenes=batch, side=side, rate=RATE_LIKE, unseen=min(steps, 32))
        with tempfile.TemporaryDirectory() as folder:
            path, start = Path(folder, "weights.npz"), read_weights(BUILT_IN)
            done, found = run(how, Path(folder), path, devices=(place,), seconds=60 * minutes, rig=rig, start=start)
            fitted = configured("learned", path)
        say(f"{name}: {done} steps; unseen generated light fields {found.errors}")
        generator = Generator((_SEED,), place, side=side, rig=rig)
        farthest = made("boxes", 1).layout.farthest
        sources = {
            f"{name}, {_PACKAGE}": {scene: partial(made, scene, 101) for scene in _UNSEEN},
            f"{name}, generated": {str(n): partial(_generated, generator, n, farthest) for n in range(_GENERATED)},
        }
        for label, some in sources.items():
            for config, records in ((configured("learned"), before), (fitted, after)):
                records += population.run(some, {label: config}, ("true",), check_cameras=False).records
    both = zip(_WEIGHTS, (before, after), strict=True)
    whole = replace(begun, records=[replace(r, name=f"{which}, {r.name}") for which, some in both for r in some])
    runs.finish(whole, out)
    gain(whole).show()


def gain(run: Run) -> Table:
    """Compare the fitted weights with those of lfgpu: ratios of errors, for each rig on scenes and generated ones."""
    shipped, fitted = (
        replace(run, records=[replace(r, name=r.details["preset"]) for r in run.records if r.name.startswith(which)])
        for which in _WEIGHTS
    )
    found = runs.against(fitted, shipped)
    return replace(found, columns=("cameras, light fields", *found.columns[1:]))


def by_weights(run: Run) -> list[Record]:
    """Return the records of the scenes of the package, with the weights as their preset and the rig in the case."""
    return [
        replace(r, case=f"{r.case}, {rig}", details={**r.details, "preset": which})
        for r in run.records
        for which, rig, source, _ in [r.name.split(", ")]
        if source == _PACKAGE
    ]


def _scene(name: str, seed: int, *, grid: tuple[int, int], off: float, size: tuple[int, int]) -> LightField:
    """Make a scene of the package with the cameras of a rig."""
    count, middle = grid[0] * grid[1], grid[0] // 2 * grid[1] + grid[1] // 2
    moved = displacements(count, middle, off, 0)
    lf = scenes.make(
        name, seed=seed, grid=grid, size=size, disparity_range=_RANGE, noise=_NOISE, displaced=moved,
        reference=divmod(middle, grid[1]),
    )  # fmt: skip
    return replace(lf, positions=lf.positions + moved, grid_shape=None, geometry=None)


def _generated(generator: Generator, number: int, farthest: float) -> LightField:
    """Draw a light field of the rig that the generator has."""
    batch = generator.draw(number, 1)
    inside = slice(batch.margin, -batch.margin)
    views = np.concatenate([batch.reference.cpu().numpy(), batch.views[0, :, inside, inside].cpu().numpy()])
    positions = np.concatenate([np.zeros((1, 2)), batch.offsets * farthest])
    truth = GroundTruth(batch.truth[0].cpu().numpy() / np.float32(farthest), (0.0, 0.0))
    return LightField(views, positions, reference=0, truth=truth, name=f"generated {number}")

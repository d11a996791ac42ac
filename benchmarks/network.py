"""Times of the parts of the learned network, each layer beside the arithmetic that it does; weights are random."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import process_time
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks import clock
from benchmarks.options import DeviceName, known_backend
from benchmarks.tables import NONE, Table
from lfgpu._backends import open_device
from lfgpu.contract import Device
from lfgpu.data import ViewLayout
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.learned import Network, layers
from lfgpu.methods.matching.unet import Weights

WIDTHS = 24, 40, 56, 72
"""Channels of the network that `lfgpu.training` trains."""

Call = Callable[..., None]

_BUDGET = 2.0  # seconds for the repeats of a part
_STEP = 0.2  # pixels per view step, between disparities


def random_weights(rng: np.random.Generator, widths: tuple[int, int, int, int] = WIDTHS) -> Weights:
    """Draw weights as large as those of a network whose training begins, but for logits that differ more."""
    weights = {}
    for name, (window, inputs, outputs) in layers(widths).items():
        size = (5 if name == "logits" else 1.4) / np.sqrt(inputs * np.prod(window))
        weights[f"{name}.weight"] = (size * rng.normal(size=(*window, inputs, outputs))).astype(np.float32)
        weights[f"{name}.bias"] = (0.1 * rng.normal(size=outputs)).astype(np.float32)
    return weights


def command(
    backend: Annotated[str, typer.Option(metavar="NAME")] = "warp",
    device: DeviceName = None,
    side: Annotated[int, typer.Option(min=1, help="Pixels of the views, each way.")] = 512,
    views: Annotated[int, typer.Option(min=1, help="Views of the grid, each way.")] = 9,
    labels: Annotated[int, typer.Option(min=4, help="Disparities, a multiple of 4.")] = 32,
    single: Annotated[bool, typer.Option(help="Store volumes in single precision.")] = False,
    repeats: Annotated[int, typer.Option(min=3)] = 10,
) -> None:
    """Time the network, and each of its parts alone."""
    rng, place = np.random.default_rng(0), open_device(known_backend(backend), device)
    middle = np.arange(views) - views // 2
    offsets = np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2).astype(np.float64)
    reference = len(offsets) // 2
    layout = ViewLayout(offsets - offsets[reference], reference, (side, side), 3, np.dtype(np.uint8), 1 / 255)
    weights = random_weights(rng)
    network = Network(Arena(place), weights, layout, labels, stored=np.float32 if single else np.float16)
    given = place.image(rng.integers(0, 256, layout.shape, np.uint8))
    first, *outputs = (place.zeros(layout.size) for _ in range(4))
    names = "disparity_out", "probability_out", "deviation_out"
    run = partial(network, first, step=_STEP, **dict(zip(names, outputs, strict=True)))
    network.load(given, None)
    calls: dict[str, list[Call]] = {"load": [partial(network.load, given, None)], "all": [run]}
    right = dict(network.parts)
    network.parts |= {name: partial(_note, calls.setdefault(name, []), part) for name, part in right.items()}
    run()
    network.parts |= right
    rows = [_row(name, some, place, repeats, weights.get(f"{name}.weight")) for name, some in calls.items()]
    Table(f"{backend} on {place.name}", ("part", "calls", "ms", "CPU ms", "GFLOP", "GFLOP/s"), 1, rows).show()


def _note(calls: list[Call], part: Call, *arguments: Any, **options: Any) -> None:
    """Note a call, and do it."""
    calls.append(partial(part, *arguments, **options))
    calls[-1]()


def _row(name: str, calls: list[Call], device: Device, repeats: int, weights: Any) -> tuple[str, ...]:
    """Time the calls of a part together; of a layer, which has weights, count the products and sums."""

    def work() -> None:
        for call in calls:
            call()

    timed = clock.measure_on(device, work, repeats=repeats, budget=_BUDGET)
    began = process_time()
    work()
    busy, seconds, arithmetic = process_time() - began, timed.seconds.median, 0.0
    if weights is not None:
        for call in calls:
            _, _, out = call.args  # type: ignore[attr-defined]  # a partial
            rows = call.keywords.get("rows")  # type: ignore[attr-defined]
            voxels = out.shape[0] * (rows.last - rows.first if rows else out.shape[1]) * out.shape[2]
            arithmetic += 2e-9 * voxels * weights.size
    numbers = f"{arithmetic:.2f}", f"{arithmetic / seconds:.0f}"
    on_cpu = NONE if device.is_gpu else f"{1e3 * busy:.1f}"
    return name, str(len(calls)), f"{1e3 * seconds:.3f}", on_cpu, *(numbers if arithmetic else (NONE, NONE))

"""Items in a second of `lfgpu batch` on several GPUs of one host, and where its workers spend their time.

The items are links to one light field, which the system keeps in memory: no disk has a say. What counts is the time
from when every worker is warm to when the first has nothing left to do. A worker is busy while it has an item; the rest
of the time it waits for one.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from PIL import Image

from benchmarks import scene
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError

KINDS = ("npy", "png")
"""One array of all views, or a folder of pictures."""

_WARM_UP = 3  # items of each worker


@dataclass(frozen=True)
class Row:
    """What so many GPUs did together."""

    case: str
    preset: str
    kind: str
    gpus: int
    workers: int
    rate: float
    """Items in a second."""
    efficiency: float
    """Of the rate on one GPU with as many workers for each, times their number."""
    busy: float
    """The share of the time in which a worker has an item."""
    seconds: dict[str, float]
    """Of the parts of an item, medians."""


def run(
    case: Case,
    preset: str,
    kinds: Sequence[str],
    counts: Sequence[tuple[int, int]],
    *,
    items: int,
    threads: int,
    disparity_range: str | None,
    say: Callable[[str], None],
) -> Iterator[Row]:
    """Measure each kind of item on each number of (GPUs, workers for each), row by row; `items` are for each worker.

    The range of each item is found anew unless one is given, as text. BenchmarkError if a batch fails.
    """
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise BenchmarkError(f"--kinds must be some of {', '.join(KINDS)}, not {unknown[0]!r}.")
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as name:
        folder = Path(name)
        say(f"casting {case.name}")
        scene.make(case, folder / "scene.npz")
        views = scene.load(folder / "scene.npz").views
        for kind in kinds:
            one = _write(views, case, folder / f"one.{kind}", kind)
            alone: dict[int, float] = {}
            for gpus, each in counts:
                say(f"{kind} on {gpus} GPUs with {each} workers each")
                workers = gpus * each
                options = ["--preset", preset, "--workers", str(workers), "--threads", str(threads)]
                options += [] if disparity_range is None else [f"--disparity-range={disparity_range}"]
                entries = _batch(one, folder / f"{kind}-{gpus}-{each}", gpus, items * workers, options)
                rate, busy, seconds = _measured(entries)
                share = rate / (gpus * alone.setdefault(each, rate / gpus))
                yield Row(case.name, preset, kind, gpus, workers, rate, share, busy, seconds)


def table(rows: Sequence[Row]) -> str:
    """As Markdown."""
    lines = [
        "| light field | preset | items | GPUs | workers | items / s | efficiency | busy | ms: read | estimate | judge "
        "| write |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        parts = " | ".join(f"{1e3 * row.seconds.get(part, 0.0):.0f}" for part in ("read", "estimate", "judge", "write"))
        lines.append(
            f"| {row.case} | {row.preset} | {row.kind} | {row.gpus} | {row.workers} | {row.rate:.1f} | "
            f"{100 * row.efficiency:.0f} % | {100 * row.busy:.0f} % | {parts} |"
        )
    return "\n".join(lines) + "\n"


def _write(views: Any, case: Case, path: Path, kind: str) -> Path:
    """One item [v, u, y, x, c]: an array, or pictures by row and column."""
    grid = np.asarray(views).reshape(*case.grid, *views.shape[1:])
    if kind == "npy":
        np.save(path, grid)
        return path
    path.mkdir()
    for v, u in np.ndindex(*case.grid):
        Image.fromarray(grid[v, u].squeeze()).save(path / f"view_{v:02d}_{u:02d}.png")
    return path


def _batch(one: Path, folder: Path, gpus: int, count: int, options: Sequence[str]) -> list[dict[str, Any]]:
    """The manifest's entries of a batch of `count` links to `one`."""
    inputs, out = folder / "in", folder / "out"
    inputs.mkdir(parents=True)
    for i in range(count):
        if one.is_file():
            os.link(one, inputs / f"item_{i:05d}{one.suffix}")
        else:
            shutil.copytree(one, inputs / f"item_{i:05d}", copy_function=os.link)
    command = [sys.executable, "-m", "lfgpu", "batch", *sorted(map(str, inputs.iterdir())), "-o", str(out), *options]
    shown = {**os.environ, "CUDA_VISIBLE_DEVICES": ",".join(map(str, range(gpus)))}
    done = subprocess.run(command, env=shown, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchmarkError(f"the batch failed: {done.stderr.strip()[-300:]}.")
    lines = (out / "manifest.jsonl").read_text(encoding="utf-8").splitlines()
    return [entry for entry in map(json.loads, lines) if entry.get("status") == "done"]


def _measured(entries: Sequence[dict[str, Any]]) -> tuple[float, float, dict[str, float]]:
    """Items in a second, the share of time that workers are busy, and the medians of an item's parts."""
    of_worker: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for entry in sorted(entries, key=lambda entry: float(entry["began"])):
        of_worker[entry["worker"]].append(entry)
    if min(map(len, of_worker.values())) <= _WARM_UP + 1:
        raise BenchmarkError("a worker had too few items to be measured; give more as --items.")
    begin = max(items[_WARM_UP]["began"] for items in of_worker.values())
    end = min(items[-1]["began"] for items in of_worker.values())
    counted = [entry for entry in entries if begin <= entry["began"] < end]
    length = end - begin
    busy = sum(entry["seconds"] for entry in counted) / (length * len(of_worker))
    parts = {part: median(entry["times"][part] for entry in counted) for part in counted[0]["times"]}
    return len(counted) / length, busy, parts

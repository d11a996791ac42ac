"""Items in a second of `lfgpu batch` on several GPUs of one host, and the time of its workers.

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
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image

from benchmarks import cases
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from benchmarks.options import CaseName, Out, Preset, Row, check_known, collected, listed, say
from benchmarks.scaling import devices_here, gpu_counts
from benchmarks.tables import Columns, Table

KINDS = ("npy", "png")
"""One array of all views, or a folder of pictures."""

_WARM_UP = 3  # items of each worker


COLUMNS: Columns = {
    "light field": "{case}",
    "preset": "{preset}",
    "items": "{kind}",
    "GPUs": "{gpus}",
    "workers": "{workers}",
    "items / s": "{rate:.1f}",
    "efficiency": lambda row: f"{100 * row['efficiency']:.0f} %",
    "busy": lambda row: f"{100 * row['busy']:.0f} %",
    **{
        f"{part}, ms": lambda row, part=part: f"{1e3 * row['seconds'].get(part, 0.0):.0f}"  # type: ignore[misc]
        for part in ("read", "estimate", "judge", "write")
    },
}


def command(
    case_name: CaseName = "9x9x512x512",
    preset: Preset = "fast",
    kinds: Annotated[str, typer.Option(metavar="KIND,...", help="Kinds of items.")] = ",".join(KINDS),
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many GPUs; default: 1, 2, 4 and all.")] = "",
    items: Annotated[int, typer.Option(min=10, help="For each worker.")] = 100,
    per_gpu: Annotated[str, typer.Option(metavar="N,...", help="Workers for each GPU.")] = "1",
    threads: Annotated[int, typer.Option(min=1, help="CPU threads of each worker.")] = 4,
    disparity_range: Annotated[
        str | None, typer.Option(metavar="LOW,HIGH", help="Of all items.", show_default="found for each")
    ] = None,
    out: Out = None,
) -> None:
    """Measure the items in a second that `lfgpu batch` does on 1, 2, 4 .. GPUs of this machine, and where they wait."""
    check_known(listed(kinds), "kind", KINDS)
    wanted = gpu_counts(counts, len(devices_here()))
    options = ["--preset", preset, "--threads", str(threads)]
    options += [] if disparity_range is None else [f"--disparity-range={disparity_range}"]
    pairs = [(gpus, int(each)) for each in listed(per_gpu) for gpus in wanted]
    rows = run(cases.parse(case_name), preset, listed(kinds), pairs, items, options)
    Table.of("", 3, collected(rows, out, benchmark="batches"), COLUMNS).show()


def run(
    case: Case,
    preset: str,
    kinds: Sequence[str],
    counts: Sequence[tuple[int, int]],
    items: int,
    options: Sequence[str],
) -> Iterator[Row]:
    """Measure each kind of item on each number of (GPUs, workers for each), row by row; `items` are for each worker.

    `options` are those of `lfgpu batch`. `rate` is items in a second, `efficiency` that over the rate on one GPU with
    as many workers, times their number, `busy` the share of the time in which a worker has an item, `seconds` the
    medians of the parts of an item. BenchmarkError if a batch fails.
    """
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as name:
        folder = Path(name)
        say(f"casting {case.name}")
        cases.cast(case, folder / "scene.npz")
        views = cases.load(folder / "scene.npz").views
        for kind in kinds:
            one = _write(views, case, folder / f"one.{kind}", kind)
            alone: dict[int, float] = {}
            for gpus, each in counts:
                say(f"{kind} on {gpus} GPUs with {each} workers each")
                workers = gpus * each
                given = [*options, "--workers", str(workers)]
                entries = _batch(one, folder / f"{kind}-{gpus}-{each}", gpus, items * workers, given)
                rate, busy, seconds = _measured(entries)
                share = rate / (gpus * alone.setdefault(each, rate / gpus))
                what = {"case": case.name, "preset": preset, "kind": kind, "gpus": gpus, "workers": workers}
                yield {**what, "rate": rate, "efficiency": share, "busy": busy, "seconds": seconds}


def _write(views: Any, case: Case, path: Path, kind: str) -> Path:
    """Write one item [v, u, y, x, c]: an array, or pictures by row and column."""
    grid = np.asarray(views).reshape(*case.grid, *views.shape[1:])
    if kind == "npy":
        np.save(path, grid)
        return path
    path.mkdir()
    for v, u in np.ndindex(*case.grid):
        Image.fromarray(grid[v, u].squeeze()).save(path / f"view_{v:02d}_{u:02d}.png")
    return path


def _batch(one: Path, folder: Path, gpus: int, count: int, options: Sequence[str]) -> list[dict[str, Any]]:
    """Run a batch of `count` links to `one`, and return the entries of its manifest."""
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
    """Compute items in a second, the share of time that workers are busy, and the medians of an item's parts."""
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

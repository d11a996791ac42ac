"""Files of one state of the code on one machine are one run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

from benchmarks.results import Run, Skipped


def machine_of(run: Run) -> str:
    """Equal where times can be compared: the same hardware with the same number of threads."""
    return json.dumps([*(run.machine.get(name) for name in ("cpu", "cores", "gpus")), run.threads])


def merged(runs: Iterable[Run]) -> list[Run]:
    """One run for each machine and state of the code, with the newest measurement of everything, oldest run first."""
    groups: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: run.date):
        state = json.dumps([machine_of(run), run.commit, run.versions])
        groups.setdefault(state, []).append(run)
    return [_one(group) for group in groups.values()]


def places(runs: Sequence[Run]) -> list[Callable[[str], str]]:
    """For each run what names its devices, so that no two runs give the same name; by themselves if it is one run."""
    if len(runs) == 1:
        return [str]
    machines = [machine_of(run) for run in runs]
    return [partial(_place, run, alike=machines.count(machine_of(run)) > 1) for run in runs]


def _place(run: Run, device: str, *, alike: bool) -> str:
    """What the device is, and where others are alike the commit and the date."""
    state = f", {(run.commit or 'no commit')[:7]}, {run.date}" if alike else ""
    gpus, number = run.machine.get("gpus") or [], device.partition(":")[2]
    if device == "cpu":
        what = f"{run.machine.get('cpu')}, {run.threads} threads"
    else:
        what = gpus[int(number)] if number.isdigit() and int(number) < len(gpus) else run.where
    return f"{device} ({what}{state})"


def _one(runs: list[Run]) -> Run:
    records = {record.key: record for run in runs for record in run.records}
    skipped: dict[Skipped, None] = {entry: None for run in runs for entry in run.skipped}
    return replace(runs[-1], records=list(records.values()), skipped=list(skipped))

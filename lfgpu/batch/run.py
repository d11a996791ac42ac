"""Batch as a whole: the choice of items to do, their run, and the summary."""

import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lfgpu.batch.cluster import BatchError, Cluster
from lfgpu.batch.items import Item, fingerprint
from lfgpu.batch.manifest import DONE, Manifest, damaged_lines, is_done, key_of, read_manifest
from lfgpu.batch.work import Job, Settings
from lfgpu.io.atomic import LEFT_OVER
from lfgpu.io.map_formats import REPORT_FILE
from lfgpu.machine import version_of

_MEASURED_ON = 8  # frames of a sequence that are tried, in order, to measure range and noise

Entry = dict[str, Any]


@dataclass
class Summary:
    """The outcome of a batch."""

    items: list[Item]
    entries: dict[str, Entry] = field(default_factory=dict)
    """The manifest entries of the items, by name, without those that were not reached."""
    kept: int = 0  # the number of items that were already up to date
    computed: int = 0
    failed: list[Entry] = field(default_factory=list)
    seconds: float = 0.0
    settings: Settings | None = None  # the settings of the estimates
    damaged: int = 0  # number of damaged lines of the manifest, which were skipped
    todo: int = 0  # number of items of this run
    workers: int = 0
    dashboard: str | None = None
    last: Entry | None = None  # entry of the item that came to its end last

    @property
    def left(self) -> int:
        """The number of items that were not reached."""
        return len(self.items) - self.kept - self.computed - len(self.failed)


class Batch:
    """Batch that computes the items that are missing, failed or out of date."""

    def __init__(self, items: Sequence[Item], out: Path, settings: Settings) -> None:
        self._items, self._out, self._settings = list(items), out, settings
        self.summary = Summary(self._items, settings=settings)
        """The outcome so far, also after an exception."""

    def run(self, cluster: Cluster, *, on_progress: Callable[[Summary], None] = lambda _: None) -> Summary:
        """Compute the items on a cluster, which is started only if there is work.

        `on_progress` is called a few times a second, and after each item. If the run ends early (Ctrl-C, a lost
        cluster, a full disk), the manifest holds what was done until then.
        """
        start, out, summary = time.perf_counter(), self._out, self.summary
        with Manifest(out) as manifest:

            def done(entries: list[Entry]) -> None:
                for entry in entries:
                    summary.entries[entry["item"]] = entry
                    if entry["status"] == DONE:
                        summary.computed += 1
                    else:
                        summary.failed.append(entry)
                manifest.add(entries)
                for entry in entries:
                    summary.last = entry
                    on_progress(summary)

            def tick(workers: int) -> None:
                summary.workers = workers
                on_progress(summary)

            summary.damaged = damaged_lines(out)
            todo = self._todo(read_manifest(out))
            summary.todo = len(todo)
            _remove_left_overs(out, self._items)
            if todo:
                manifest.add(_parameter_sets(todo))
                try:
                    with cluster:
                        summary.dashboard = cluster.dashboard
                        cluster.run(_sequences(todo), done, tick)
                finally:
                    summary.seconds = time.perf_counter() - start
        if manifest.unwritten:
            lost = sum("item" in entry for entry in manifest.unwritten)
            raise BatchError(
                f"the disk is full: the manifest in {out} lacks {lost} of the items that are done; free "
                "some space and run the same command again, which repeats them."
            )
        self._check_there()
        return summary

    def _check_there(self) -> None:
        """BatchError if outputs are missing, because workers on another machine wrote them to a local disk."""
        away = [
            name
            for name, entry in self.summary.entries.items()
            if not all((self._out / name / file).is_file() for file in entry.get("sizes", ()))
        ]
        if away:
            raise BatchError(
                f"{len(away)} items, such as {away[0]}, are done, but their outputs are not in {self._out}; use a "
                "folder that all workers and this machine share under the same path."
            )

    def _todo(self, known: Mapping[str, Entry]) -> list[Job]:
        todo = []
        for job in _jobs(self._items, self._out, self._settings):
            entry = known.get(job.item.name)
            is_up_to_date = is_done(entry, job.item, job.keys["parameters_key"], job.keys["input_key"], self._out)
            if is_up_to_date and entry is not None and (not job.settings.report or REPORT_FILE in entry["sizes"]):
                self.summary.entries[job.item.name] = entry
                self.summary.kept += 1
            else:
                todo.append(job)
        return todo


def _jobs(items: Sequence[Item], out: Path, settings: Settings) -> list[Job]:
    frames: dict[str, list[Item]] = defaultdict(list)
    for item in items:
        if item.sequence and len(frames[item.sequence]) < _MEASURED_ON:
            frames[item.sequence].append(item)
    first = {sequence: tuple(items) for sequence, items in frames.items()}
    began_with = {sequence: fingerprint(items[0].source, leave_out=out) for sequence, items in first.items()}
    parameters = {of: key_of(settings.config, {**settings.options, "sequence": of}) for of in (False, True)}
    return [
        Job(
            item,
            settings,
            str(out.resolve()),
            first.get(item.sequence, ()),
            {
                "parameters_key": parameters[bool(item.sequence)],
                "input_key": "-".join(
                    filter(None, (fingerprint(item.source, leave_out=out), began_with.get(item.sequence)))
                ),
            },
        )
        for item in items
    ]


def _sequences(jobs: Sequence[Job]) -> list[list[Job]]:
    """Group the jobs of each sequence, in order; other jobs are sequences of one."""
    found: dict[str, list[Job]] = defaultdict(list)
    for job in jobs:
        found[job.item.sequence or f"\0{job.item.name}"].append(job)
    return list(found.values())


def _parameter_sets(jobs: Sequence[Job]) -> list[Entry]:
    """Make a manifest line for each set of parameters; items refer to it by its key."""
    sets = {job.keys["parameters_key"]: job for job in jobs}
    return [
        {
            "parameters_key": key,
            "parameters": asdict(job.settings.config),
            "options": {**job.settings.options, "sequence": bool(job.item.sequence)},
            "version": version_of("lfgpu") or "not installed",
            "began": time.time(),
        }
        for key, job in sets.items()
    ]


def _remove_left_overs(out: Path, items: Sequence[Item]) -> None:
    """Remove incomplete outputs of killed processes; no other process writes here."""
    folders = {(out / item.name).parent for item in items} | {out / item.name for item in items}
    for folder in folders:
        if folder.is_dir():
            for path in folder.glob(f"{LEFT_OVER}*"):
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)

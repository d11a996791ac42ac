"""A job: what one worker process measures."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.results import Record, record


@dataclass(frozen=True)
class Job:
    """One backend on one device.

    Parameters
    ----------
    kind
        "operation", "pipeline" or "bandwidth", as in the records that come back.
    case
        Name of the case; "" for the bandwidth.
    names
        What is measured, one record each: operations; pipelines; "copy" and "axpby".
    repeats
        At most so many; of the resident method on a GPU exactly so many.
    scene
        The file that holds the light field of a pipeline.
    """

    kind: str
    backend: str
    device: str
    case: str
    names: tuple[str, ...]
    repeats: int
    scene: str = ""

    def __str__(self) -> str:
        name = self.names[0] if len(self.names) == 1 else ""
        return " ".join(filter(None, (self.backend, self.device, self.case, self.kind, name)))

    def without(self, names: set[str]) -> Job:
        """The same without some of the names."""
        return replace(self, names=tuple(name for name in self.names if name not in names))

    def failed(self, name: str, reason: str) -> Record:
        """The record of something that could not be measured."""
        return Record(self.kind, self.backend, self.device, self.case, name, failed=reason)


def write_job(job: Job, path: Path) -> None:
    """For the worker."""
    path.write_text(json.dumps(asdict(job)))


def read_job(path: Path) -> Job:
    """In the worker."""
    values = json.loads(path.read_text())
    return Job(**{**values, "names": tuple(values["names"])})


def append_record(path: Path, result: Record) -> None:
    """A line of its own, at once: what was measured before a crash is kept."""
    with path.open("a", encoding="utf-8") as out:
        out.write(json.dumps(asdict(result)) + "\n")


def read_records(path: Path) -> Iterator[Record]:
    """All whole lines."""
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                yield record(json.loads(line))
            except ValueError:  # the process ended while it wrote
                return

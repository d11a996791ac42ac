"""One measurement of one backend on one device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.results import Record


@dataclass(frozen=True)
class Job:
    """One thing that is measured in a process of its own.

    Parameters
    ----------
    kind
        "operation", "pipeline" or "bandwidth", as in its records.
    case
        Name of the case; "" for the bandwidth.
    name
        Name of the pipeline; of operations, name of the preset.
    repeats
        At most so many; of the resident method on a GPU exactly so many.
    scene
        The file that holds the light field.
    """

    kind: str
    backend: str
    device: str
    case: str
    name: str
    repeats: int
    scene: str = ""

    def __str__(self) -> str:
        return " ".join(filter(None, (self.backend, self.device, self.case, self.kind, self.name)))

    def record(self, name: str = "", **values: Any) -> Record:
        """Make a record of this job; `name` is that of the job by default."""
        return Record(self.kind, self.backend, self.device, self.case, name or self.name, **values)

"""Measurements as data, their JSON files, and runs put together from several files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from lfgpu.errors import LfgpuError
from lfgpu.io.atomic import atomic_write
from lfgpu.threads import get_threads

SCHEMA = 2
FOLDER = Path(__file__).with_name("results")

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Spread:
    """Seconds of one call: median, quartiles and 99 % quantile of n repeats."""

    median: float
    q1: float
    q3: float
    n: int
    p99: float


@dataclass(frozen=True)
class Record:
    """One measurement, or the reason why there is none."""

    kind: str
    """operation, pipeline, bandwidth, accuracy, ablation, paper or forms."""
    backend: str
    device: str
    case: str
    name: str
    """Name of the operation, of the pipeline, of the preset, of the variant."""
    seconds: Spread | None = None
    calls: int = 1
    """Calls between two synchronisations; `seconds` are of one."""
    bytes: int | None = None
    """Bytes that one call has to read and to write."""
    limit: float | None = None
    """Seconds that these bytes take at the best bandwidth measured on this device in this run."""
    errors: dict[str, float] = field(default_factory=dict)
    """Measures of the output of which less is better."""
    compared: str = ""
    """The truth that the errors are about, and how many pixels count."""
    host_bytes: int | None = None
    """Peak resident memory of the process."""
    gpu_bytes: int | None = None
    """Growth of the used memory of the GPUs since the process began."""
    details: dict[str, Any] = field(default_factory=dict)
    failed: str = ""

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """Kind, case, name, backend and device: equal for the same measurement in another file."""
        return self.kind, self.case, self.name, self.backend, self.device


@dataclass(frozen=True)
class Skipped:
    """A backend or device that was not measured, and why."""

    backend: str
    device: str
    reason: str


@dataclass(frozen=True)
class Run:
    """A run: its measurements, and the machine and versions that they were made with."""

    date: str
    machine: dict[str, Any]
    versions: dict[str, str | None]
    commit: str | None
    threads: int
    load: float | None
    """Load average of the machine when the run began."""
    records: list[Record]
    skipped: list[Skipped]
    schema: int = SCHEMA
    sources: dict[str, str] = field(default_factory=dict)
    """The benchmark, and the hash of its sources (`benchmarks.sources`)."""

    @classmethod
    def begun(cls, benchmark: str, threads: int | None = None) -> Run:
        """Begin a run of a benchmark without records on this machine, with so many threads of the CPU."""
        date, threads = datetime.now(UTC).isoformat(timespec="seconds"), threads or get_threads()
        return cls(
            date, **machine.about(benchmark), threads=threads, load=machine.load_average(), records=[], skipped=[]
        )

    @property
    def where(self) -> str:
        """The machine in a few words."""
        m = self.machine
        gpus = "".join(f", {gpu}" for gpu in dict.fromkeys(m.get("gpus") or ()))
        return f"{m.get('cpu')}, {m.get('cores')} cores{gpus}"

    @property
    def place(self) -> str:
        """A text that is equal where times can be compared: the same hardware with the same number of threads."""
        return json.dumps([*(self.machine.get(name) for name in ("cpu", "cores", "gpus")), self.threads])


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def save(run: Run, path: Path) -> None:
    """Write the file of a run."""
    write_json(path, asdict(run))


def load(path: Path) -> Run:
    """Read the file of a run; BenchmarkError says why it cannot be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise BenchmarkError(f"{path} is not a JSON file of a benchmark run.") from error
    if not isinstance(content, dict) or "schema" not in content or "records" not in content:
        raise BenchmarkError(f"{path} is not a JSON file of a benchmark run.")
    if content["schema"] != SCHEMA:
        raise BenchmarkError(f"{path} has schema {content['schema']!r}, but only {SCHEMA} can be read: measure again.")
    try:
        content["records"] = [_record(values) for values in content["records"]]
        content["skipped"] = [_checked(Skipped, values) for values in content["skipped"]]
        return _checked(Run, content)
    except (TypeError, KeyError, LfgpuError) as error:
        raise BenchmarkError(f"{path} is not a whole file of a benchmark run ({error}).") from error


def merged(runs: Iterable[Run]) -> list[Run]:
    """Put runs of one state of the code on one machine together, with the newest of each measurement; oldest first."""
    groups: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: run.date):
        groups.setdefault(json.dumps([run.place, run.commit, run.versions]), []).append(run)
    return [_one(group) for group in groups.values()]


def _one(runs: list[Run]) -> Run:
    records = {record.key: record for run in runs for record in run.records}
    skipped: dict[Skipped, None] = {entry: None for run in runs for entry in run.skipped}
    return replace(runs[-1], records=list(records.values()), skipped=list(skipped))


def _record(values: dict[str, Any]) -> Record:
    seconds = values.get("seconds")
    return _checked(Record, {**values, "seconds": None if seconds is None else _checked(Spread, seconds)})


def _checked(kind: type[Kind], values: dict[str, Any]) -> Kind:
    names = {f.name for f in fields(kind)}  # type: ignore[arg-type]  # only dataclasses are asked for
    unknown = set(values) - names
    if unknown:
        raise BenchmarkError(f"unknown: {', '.join(sorted(unknown))}")
    return kind(**values)

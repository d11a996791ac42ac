"""What was measured, as data, and its JSON file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.errors import BenchmarkError
from lfgpu.errors import LfgpuError
from lfgpu.io.atomic import atomic_write

SCHEMA = 2

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
    """One thing that was measured, or the reason why it could not be."""

    kind: str
    """operation, pipeline, bandwidth, startup or ablation."""
    backend: str
    device: str
    case: str
    name: str
    """Of the operation, of the pipeline, of what is started, or of what is left out."""
    seconds: Spread | None = None
    calls: int = 1
    """Calls between two synchronisations; `seconds` are of one."""
    bytes: int | None = None
    """Compulsory traffic of one call."""
    limit: float | None = None
    """Seconds that the traffic takes at the best bandwidth measured on this device in this run."""
    errors: dict[str, float] = field(default_factory=dict)
    """What came out, in measures of which less is better."""
    compared: str = ""
    """What of the output the errors are about."""
    host_bytes: int | None = None
    """Peak resident memory of the process."""
    gpu_bytes: int | None = None
    """Growth of the GPU's used memory since the process began."""
    details: dict[str, Any] = field(default_factory=dict)
    failed: str = ""

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """What makes it the same measurement in another file."""
        return self.kind, self.case, self.name, self.backend, self.device


@dataclass(frozen=True)
class Skipped:
    """A backend or device that was not measured, and why."""

    backend: str
    device: str
    reason: str


@dataclass(frozen=True)
class Run:
    """All that one run of the benchmark found, and where."""

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

    @property
    def where(self) -> str:
        """The machine in a few words."""
        m = self.machine
        gpus = "".join(f", {gpu}" for gpu in dict.fromkeys(m.get("gpus") or ()))
        return f"{m.get('cpu')}, {m.get('cores')} cores{gpus}"


def save(run: Run, path: Path) -> None:
    """Write the JSON file whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(asdict(run), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def load(path: Path) -> Run:
    """Read a JSON file; BenchmarkError says what is wrong with it."""
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
        content["records"] = [record(values) for values in content["records"]]
        content["skipped"] = [_checked(Skipped, values) for values in content["skipped"]]
        return _checked(Run, content)
    except (TypeError, KeyError, LfgpuError) as error:
        raise BenchmarkError(f"{path} is not a whole file of a benchmark run ({error}).") from error


def record(values: dict[str, Any]) -> Record:
    """A record from what `asdict` made of it."""
    seconds = values.get("seconds")
    return _checked(Record, {**values, "seconds": None if seconds is None else _checked(Spread, seconds)})


def _checked(kind: type[Kind], values: dict[str, Any]) -> Kind:
    names = {f.name for f in fields(kind)}  # type: ignore[arg-type]  # only dataclasses are asked for
    unknown = set(values) - names
    if unknown:
        raise BenchmarkError(f"unknown: {', '.join(sorted(unknown))}")
    return kind(**values)

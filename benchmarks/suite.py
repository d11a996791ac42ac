"""The default command: time, memory and error of every backend on every device."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import bandwidth, cases, operations, pipelines, processes
from benchmarks.cases import Case
from benchmarks.job import Job
from benchmarks.options import check_known, check_out, known_backend, listed, say
from benchmarks.results import Record, Run, Skipped
from benchmarks.runs import finish
from lfgpu._backends import list_backends, load
from lfgpu.methods import PRESETS
from lfgpu.threads import get_threads

OPERATIONS = ("fast", "accurate", "paper")
"""Presets whose operations are measured by default."""

_REFERENCE = "reference"
_MOST_REPEATS = {pipelines.SCRATCH: 5, pipelines.SCIPY: 3}
_MEASURES = {"bandwidth": bandwidth.measure, "operation": operations.measure, "pipeline": pipelines.measure}
_NONE = "none"


@dataclass(frozen=True)
class Plan:
    """The measurements to make, as the options of `measure` say; `devices` None is the CPU and the first GPU."""

    cases: tuple[Case, ...]
    backends: tuple[str, ...]
    operations: tuple[str, ...] = OPERATIONS
    pipelines: tuple[str, ...] = pipelines.NAMES
    devices: tuple[str, ...] | None = None
    repeats: int = 15
    threads: int = 1
    runs: int = 50
    timeout: float = 600.0

    @property
    def variables(self) -> dict[str, str]:
        """The environment of the processes, so far as it differs from that of this one."""
        return processes.threads_in(self.threads)


def measure(
    context: typer.Context,
    case_names: Annotated[
        str,
        typer.Option(
            "--cases", metavar="NAME,...", help="ROWSxCOLUMNSxHEIGHTxWIDTH[@SPAN]; default: those for minutes."
        ),
    ] = "",
    presets: Annotated[
        str,
        typer.Option("--operations", metavar="PRESET,...", help='Presets whose operations are measured, or "none".'),
    ] = ",".join(OPERATIONS),
    ways: Annotated[
        str, typer.Option("--pipelines", metavar="NAME,...", help='Ways to run the whole method, or "none".')
    ] = ",".join(pipelines.NAMES),
    backends: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all.")] = "",
    devices: Annotated[
        str, typer.Option(metavar="NAME,...", help="cpu, cuda:0 ...; default: the CPU and the first GPU.")
    ] = "",
    repeats: Annotated[
        int, typer.Option(min=1, help="Most repeats of a call; long calls are repeated less often.")
    ] = 15,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads of the CPU; default: one for each core.")] = None,
    timeout: Annotated[float, typer.Option(min=1, help="Seconds that one process may take.")] = 600,
    runs: Annotated[int, typer.Option(min=1, help="Repeats of the resident method on a GPU.")] = 50,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="File of the results.")] = None,
) -> None:
    """Measure time, memory and error of every backend on every device, and print tables."""
    if context.invoked_subcommand is not None:
        return
    timed, whole = (tuple(listed(text)) if text != _NONE else () for text in (presets, ways))
    check_known(timed, "preset", tuple(PRESETS))
    check_known(whole, "pipeline", pipelines.NAMES)
    plan = Plan(
        tuple(cases.parse(n) for n in listed(case_names)) or tuple(c for c in cases.CASES if c.default),
        tuple(known_backend(n) for n in listed(backends)) or list_backends(),
        timed,
        whole,
        devices=tuple("cuda:0" if n == "cuda" else n for n in listed(devices)) or None,
        repeats=repeats,
        threads=threads or get_threads(),
        runs=runs,
        timeout=timeout,
    )
    check_out(out)
    finish(run(plan), out)


def run(plan: Plan) -> Run:
    """Measure everything, one process at a time."""
    begun = Run.begun("suite", plan.threads)
    targets, skipped = _targets(plan)
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        records = list(_records(plan, targets, Path(folder)))
    return replace(begun, records=bandwidth.with_limits(records), skipped=skipped)


def done(job: Job, plan: Plan) -> list[Record]:
    """Measure a job in a process of its own; if it fails, the last record says why."""
    say(str(job))
    found, failure = processes.collect(_MEASURES[job.kind], job, variables=plan.variables, timeout=plan.timeout)
    return [*found, job.record(failed=failure)] if failure else found


def _records(plan: Plan, targets: list[tuple[str, str]], folder: Path) -> Iterator[Record]:
    if plan.operations and targets:
        if any(device == "cpu" for _, device in targets):
            say("numpy cpu bandwidth")
            yield bandwidth.numpy_copy(plan.threads, plan.repeats)
        for target in targets:
            if target[0] != _REFERENCE:  # which is NumPy
                yield from done(Job("bandwidth", *target, "", "copy", plan.repeats), plan)
    for kind, names in (("operation", plan.operations), ("pipeline", plan.pipelines)):
        for case in plan.cases:
            some = [target for target in targets if case.tiny or target[0] != _REFERENCE]
            path = _scene(case, folder) if some and names else folder
            for name in names:
                for target in some:
                    repeats = _repeats(plan, kind, name, target[1])
                    yield from done(Job(kind, *target, case.name, name, repeats, str(path)), plan)


def _targets(plan: Plan) -> tuple[list[tuple[str, str]], list[Skipped]]:
    """Find (backend, device) of all that can be measured, and what cannot."""
    targets, skipped = [], []
    for backend in plan.backends:
        there, why = processes.collect(_devices, backend, variables=plan.variables, timeout=plan.timeout)
        if why:
            skipped.append(Skipped(backend, ", ".join(plan.devices or ("any device",)), why))
            continue
        for device in plan.devices or [device for device in ("cpu", "cuda:0") if device in there] or there[:1]:
            if device in there:
                targets.append((backend, device))
            else:
                skipped.append(Skipped(backend, device, f"no such device here; there is {', '.join(there)}"))
        if backend == _REFERENCE and not all(case.tiny for case in plan.cases):
            reason = "float64 NumPy, written to be read: timed at the smallest cases only"
            skipped.append(Skipped(backend, "cpu", reason))
    return targets, skipped


def _devices(backend: str) -> Iterable[str]:
    return load(backend).devices()


def _repeats(plan: Plan, kind: str, name: str, device: str) -> int:
    if (kind, name) == ("pipeline", pipelines.RESIDENT) and device != "cpu":
        return plan.runs
    return min(plan.repeats, _MOST_REPEATS.get(name, plan.repeats) if kind == "pipeline" else plan.repeats)


def _scene(case: Case, folder: Path) -> Path:
    path = folder / f"{case.name}.npz"
    if not path.exists():
        say(f"ray-casting {case.name}")
        cases.cast(case, path)
    return path

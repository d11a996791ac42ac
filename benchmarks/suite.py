"""A whole run: what is asked for, on what is there."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from benchmarks import bandwidth, machine, pipelines, processes, scene, startup
from benchmarks.cases import STARTUP_CASE, Case
from benchmarks.jobs import Job
from benchmarks.operation import Operation
from benchmarks.results import Record, Run, Skipped

_REFERENCE = "reference"
_MOST_REPEATS = {pipelines.SCRATCH: 5, pipelines.SCIPY: 3}

Say = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """What is asked for.

    Parameters
    ----------
    cases, operations, backends
        What to measure.
    devices
        On which devices; None for the CPU and the first GPU, where a backend has them.
    pipelines
        In which ways the whole method is measured.
    startup
        Whether start-up is measured.
    repeats, threads
        At most so many repeats, with at most so many threads of the CPU.
    runs
        Repeats of the resident method on a GPU.
    timeout
        Seconds that one process may take.
    """

    cases: tuple[Case, ...]
    operations: tuple[Operation, ...]
    backends: tuple[str, ...]
    devices: tuple[str, ...] | None
    pipelines: tuple[str, ...]
    startup: bool
    repeats: int
    runs: int
    threads: int
    timeout: float


def run(plan: Plan, say: Say) -> Run:
    """Measure everything, one process at a time; `say` is told what is being measured."""
    load, date = machine.load_average(), datetime.now(UTC).isoformat(timespec="seconds")
    env = processes.environment(plan.threads)
    targets, skipped = _targets(plan, env)
    records: list[Record] = []
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        if plan.startup:
            say("import of lfgpu")
            records.append(startup.import_time(env))
        if plan.operations and targets:
            records += _operations(plan, targets, env, say)
        if plan.pipelines and targets:
            records += _pipelines(plan, targets, Path(folder), env, say)
        if plan.startup and targets:
            path = _scene(STARTUP_CASE, Path(folder), say)
            for backend, device in targets:
                say(f"{backend} {device} start-up")
                records += startup.first_results(backend, device, path, env, plan.timeout)
    return Run(
        date,
        machine.describe(),
        machine.versions(),
        machine.commit(),
        plan.threads,
        load,
        bandwidth.with_limits(records),
        skipped,
    )


def _targets(plan: Plan, env: dict[str, str]) -> tuple[list[tuple[str, str]], list[Skipped]]:
    """(backend, device) of all that can be measured, and what cannot."""
    targets, skipped = [], []
    for backend in plan.backends:
        there, why = processes.probe(backend, env, plan.timeout)
        wanted = plan.devices or [device for device in ("cpu", "cuda:0") if device in there] or there[:1]
        if why:
            skipped.append(Skipped(backend, ", ".join(plan.devices or ("any device",)), why))
            continue
        for device in wanted:
            if device in there:
                targets.append((backend, device))
            else:
                skipped.append(Skipped(backend, device, f"no such device here; there is {', '.join(there)}"))
        if backend == _REFERENCE and not all(case.tiny for case in plan.cases):
            skipped.append(
                Skipped(backend, "cpu", "float64 NumPy, written to be read: timed at the smallest cases only")
            )
    return targets, skipped


def _operations(plan: Plan, targets: list[tuple[str, str]], env: dict[str, str], say: Say) -> Iterator[Record]:
    if any(device == "cpu" for _, device in targets):
        say("numpy cpu bandwidth")
        yield bandwidth.numpy_copy(plan.threads, plan.repeats)
    measured = [target for target in targets if target[0] != _REFERENCE]  # which is NumPy
    jobs = [Job("bandwidth", *target, "", bandwidth.NAMES, plan.repeats) for target in measured]
    names = tuple(operation.name for operation in plan.operations)
    jobs += [Job("operation", *target, case.name, names, plan.repeats) for case, target in _pairs(plan.cases, targets)]
    yield from _run_all(jobs, env, plan.timeout, say)


def _pipelines(
    plan: Plan, targets: list[tuple[str, str]], folder: Path, env: dict[str, str], say: Say
) -> Iterator[Record]:
    for case in plan.cases:
        pairs = list(_pairs([case], targets))
        if pairs:
            path = _scene(case, folder, say)
            # Each in a process of its own, so that no one uses what another one has allocated.
            jobs = [
                Job("pipeline", *target, case.name, (name,), _repeats(plan, name, target[1]), str(path))
                for name in plan.pipelines
                for _, target in pairs
            ]
            yield from _run_all(jobs, env, plan.timeout, say)


def _repeats(plan: Plan, name: str, device: str) -> int:
    if name == pipelines.RESIDENT and device != "cpu":
        return plan.runs
    return min(plan.repeats, _MOST_REPEATS.get(name, plan.repeats))


def _pairs(cases: Iterable[Case], targets: list[tuple[str, str]]) -> Iterator[tuple[Case, tuple[str, str]]]:
    for case in cases:
        for backend, device in targets:
            if case.tiny or backend != _REFERENCE:
                yield case, (backend, device)


def _run_all(jobs: Iterable[Job], env: dict[str, str], timeout: float, say: Say) -> Iterator[Record]:
    for job in jobs:
        say(str(job))
        yield from processes.run(job, env, timeout)


def _scene(case: Case, folder: Path, say: Say) -> Path:
    path = folder / f"{case.name}.npz"
    if not path.exists():
        say(f"ray-casting {case.name}")
        scene.make(case, path)
    return path

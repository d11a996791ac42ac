"""Every operation of the kernels on a GPU against the reference, and a result file that names the commit.

CI has no GPU. It runs the CPU's kernels, and those of a GPU in emulated blocks (`tests/kernels/test_gpu_kernels.py`).
The same matrix on a machine with a GPU tells what a GPU makes of them; that result file is committed. It is written
after each test function, so that a run that is cut off leaves what it found, and the next one goes on from there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import chdir
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import pytest

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import atomic_write

ROOT = Path(__file__).parents[1]
TESTS = (
    "tests/kernels",
    "tests/test_printed_equations.py",
    "tests/test_solvers.py",
    "tests/test_interop.py",
    "tests/test_pipelines.py",
    "tests/test_depth_pipeline.py",
)
ELSEWHERE = ("tests/kernels/test_gpu_kernels.py",)
"""Tests that are about the CPU."""
_SAME = ("commit", "machine", "versions", "backend", "device")
"""What a file must share with a run that goes on with it."""


def run(backend: str, device: str, out: Path, *, commit: str | None = None, workers: int = 1) -> dict[str, Any]:
    """Run the tests on a device: what passed, failed and was skipped, and the largest error of each operation.

    Parameters
    ----------
    backend, device
        The kernels that are held against the reference.
    out
        The result file. It is written after each test function that has ended. If it holds an unfinished run of the
        same commit, machine, backend and device, only the functions that it lacks are run.
    commit
        What the file names, where the checkout is a copy without git.
    workers
        Processes that share the device.

    Raises
    ------
    BenchmarkError
        If the tests cannot run.
    """
    about = {
        "commit": commit or machine.commit(),
        "machine": machine.describe(),
        "versions": machine.versions(),
        "backend": backend,
        "device": device,
    }
    recorder = _Recorder(out, about, _unfinished(out, about))
    command = ["-q", f"--backend={backend}", f"--device={device}", "-p", "no:cacheprovider", *TESTS]
    command += [f"--ignore={path}" for path in ELSEWHERE]
    command += [f"--deselect={name}" for name in recorder.functions]
    if workers > 1:
        command += ["-n", str(workers)]
    with chdir(ROOT):
        status = pytest.main(command, plugins=[recorder])
    nothing_left = status == pytest.ExitCode.NO_TESTS_COLLECTED and recorder.functions
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED) and not nothing_left:
        raise BenchmarkError(f"the tests could not run to their end on {backend} {device}; see what pytest said above.")
    return recorder.save(complete=True)


def workers() -> int:
    """How many processes may share a device: one without pytest-xdist, else one for two cores, at most eight."""
    if find_spec("xdist") is None:
        return 1
    return max(1, min(8, int(machine.describe()["cores"] or 1) // 2))


def _unfinished(path: Path, about: dict[str, Any]) -> dict[str, Any]:
    """What an unfinished run of the same kind has left; {} if there is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if found.get("complete", True) or any(found.get(name) != about[name] for name in _SAME):
        return {}
    return dict(found)


class _Recorder:
    """A plugin of pytest that keeps what each test function found, and writes the file when one has ended."""

    def __init__(self, out: Path, about: dict[str, Any], before: dict[str, Any]) -> None:
        self._out, self._about, self._start = out, about, perf_counter()
        self._seconds = float(before.get("seconds", 0.0))
        self.functions: dict[str, dict[str, Any]] = dict(before.get("functions", {}))
        self._left: dict[str, int] = {}
        self._running: dict[str, dict[str, Any]] = {}

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """All tests, in a single process."""
        self._expect(item.nodeid for item in session.items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: list[str]) -> None:
        """All tests, as each of several processes found them."""
        if not self._left:
            self._expect(ids)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """One of the three phases of a test has ended."""
        name = _function(report.nodeid)
        found = self._running.setdefault(name, {"passed": 0, "skipped": 0, "failed": [], "errors": {}})
        if report.failed and report.nodeid not in found["failed"]:
            found["failed"].append(report.nodeid)
        found["skipped"] += report.skipped
        found["passed"] += report.passed and report.when == "call"
        if report.when != "teardown":
            return
        for output, error in report.user_properties:
            found["errors"][output] = max(float(str(error)), found["errors"].get(output, 0.0))
        self._left[name] -= 1
        if not self._left[name]:
            self.functions[name] = self._running.pop(name)
            self.save(complete=False)

    def save(self, *, complete: bool) -> dict[str, Any]:
        """Write the file whole, and return what is in it."""
        done = self.functions.values()
        errors: dict[str, float] = {}
        for found in done:
            for output, error in found["errors"].items():
                errors[output] = max(error, errors.get(output, 0.0))
        content = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            **self._about,
            "complete": complete,
            "seconds": round(self._seconds + perf_counter() - self._start, 1),
            "passed": sum(found["passed"] for found in done),
            "skipped": sum(found["skipped"] for found in done),
            "failed": [test for found in done for test in found["failed"]],
            "errors": dict(sorted(errors.items())),
            "functions": dict(sorted(self.functions.items())),
        }
        with atomic_write(self._out) as temporary:
            temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return content

    def _expect(self, tests: Iterable[str]) -> None:
        for test in tests:
            name = _function(test)
            self._left[name] = self._left.get(name, 0) + 1


def _function(test: str) -> str:
    return test.partition("[")[0]

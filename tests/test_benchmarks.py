"""The benchmark: that it runs, that it measures what it says, and that it notices what it is for."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import clock, pipelines, results, suite
from benchmarks.cases import CASES
from benchmarks.cli import app
from benchmarks.compare import compare
from benchmarks.results import Record, Run, Spread

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[1]

TINY = CASES[0]
WAYS = ("paper", "resident", "scipy", "fast")


def benchmarks(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


def told(*arguments: str | Path) -> Any:
    """Return the output of a command, without a process of its own."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the tiny case, with a device that is not there."""
    out = tmp_path_factory.mktemp("benchmarks") / "run.json"
    done = benchmarks(
        *("--cases", TINY.name, "--operations", "fast", "--backends", "warp", "--devices", "cpu,cuda:99"),
        *("--pipelines", ",".join(WAYS), "--repeats", "1", "--threads", "1", "--out", out),
    )
    assert done.returncode == 0, done.stderr
    assert "semi_global" in done.stdout
    assert "BadPix" in done.stdout
    assert "not measured: warp cuda:99" in done.stdout
    return out


def run_of(*records: Record, **fields: object) -> Run:
    machine = {"cpu": "a CPU", "cores": 2, "gpus": [], "system": "a system", "python": "3.12"}
    run = Run("2030-01-01T00:00:00+00:00", machine, {"lfgpu": "1"}, "c0ffee", 2, 0.0, list(records), [])
    return replace(run, **fields)  # type: ignore[arg-type]


def record_of(median: float = 1.0, *, half_spread: float = 0.01, error: float = 1e-6) -> Record:
    spread = Spread(median, median - half_spread, median + half_spread, 9, median + half_spread)
    return Record("operation", "warp", "cpu", CASES[1].name, "cold", spread, bytes=10**6, errors={"relative": error})


# --- a run ---


def test_the_page_on_measuring_has_each_case() -> None:
    text = (ROOT / "benchmarks" / "measuring.md").read_text(encoding="utf-8")
    assert all(f"`{case.name}`" in text for case in CASES)


def test_a_run_has_times_errors_and_memory(measured: Path) -> None:
    run = results.load(measured)
    assert run.threads == 1
    assert run.machine["cpu"]
    assert run.versions["numpy"] == np.__version__
    found = {(r.kind, r.backend, r.name) for r in run.records if r.kind != "operation"}
    assert found == {
        *(("pipeline", "warp", name) for name in WAYS),
        *(("bandwidth", *pair) for pair in (("numpy", "copy"), ("warp", "copy"), ("warp", "axpby"))),
    }
    for record in run.records:
        assert not record.failed
        assert 0 < record.seconds.q1 <= record.seconds.median <= record.seconds.q3 <= record.seconds.p99
        if record.kind == "pipeline":
            energy = set() if record.name in pipelines.MATCHING else {"energy"}
            assert record.errors.keys() == {"mse_100", "badpix_07", "badpix_03", "badpix_01", "q25"} | energy
            assert record.details["iterations"] > 0
            transfers = () if record.name == "paper" else ("upload", "download")
            matched = record.name in pipelines.MATCHING
            expected = {"sweep", "resweep", "align", "boundaries"} if matched else {"local", "propagate", "refine"}
            assert set(record.details["stages"]) == {*expected, *transfers}
            assert record.host_bytes is not None
            assert record.host_bytes > 10**7


def test_operations_are_those_of_a_frame_with_their_bytes(measured: Path) -> None:
    found = {r.name: r for r in results.load(measured).records if r.kind == "operation"}
    cold, warm = ({name.partition(": ")[2] for name in found if name.startswith(f)} for f in ("fast: ", "fast, warm: "))
    assert warm - cold >= {"motion.find", "motion.carry", "bias", "blend"}
    assert cold >= {"plane_sweep.by_view_sets", "plane_sweep.by_visibility", "semi_global", "alignment"}
    assert found["fast, warm: motion.carry"].bytes == 8 * 4 * 48 * 48  # four fields before, and four carried along
    assert all(record.limit for record in found.values())


def test_what_is_not_there_is_listed(measured: Path) -> None:
    skipped = {(s.backend, s.device): s.reason for s in results.load(measured).skipped}
    assert skipped.keys() == {("warp", "cuda:99")}
    assert "there is cpu" in skipped["warp", "cuda:99"]
    run = suite.run(suite.Plan((TINY,), ("nosuch",)))
    assert run.records == []
    assert [(s.backend, s.device) for s in run.skipped] == [("nosuch", "any device")]
    assert "unknown backend" in run.skipped[0].reason


# --- clocks, memory and its limit ---


def test_the_clock_batches_short_calls() -> None:
    timed = clock.measure(lambda: None, lambda: None, repeats=4, budget=10.0)
    assert timed.calls > 100
    assert timed.seconds.n == 4
    assert not timed.captured
    timed = clock.measure(lambda: None, lambda: None, repeats=1, budget=1.0, capture=lambda _: None)
    assert not timed.captured


@pytest.mark.parametrize(("on_gpu", "taken", "runs"), [(True, 1.0, 3), (True, 0.25, 6), (False, 0.25, 3)])
def test_a_gpu_is_warm_before_it_is_timed(
    on_gpu: bool, taken: float, runs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clock rises in the first second of work; on a CPU a few runs will do."""
    ends: list[float] = []
    monkeypatch.setattr(clock, "perf_counter", lambda: ends[-1] if ends else 0.0)
    pipelines._warm_up(lambda: ends.append((len(ends) + 1) * taken), repeats=50, on_gpu=on_gpu)
    assert len(ends) == runs


# --- files ---


def test_files_of_one_state_on_one_machine_are_one_run() -> None:
    other = replace(record_of(2.0), name="warm")
    later = run_of(record_of(3.0), other, date="2030-02-01T00:00:00+00:00")
    (run,) = results.merged([later, run_of(record_of())])
    assert run.date == later.date
    assert {r.name: r.seconds.median for r in run.records if r.seconds} == {"cold": 3.0, "warm": 2.0}
    changed = [run_of(record_of()), run_of(record_of(), commit="decade"), run_of(record_of(), threads=1)]
    assert len(results.merged(changed)) == 3


# --- tables ---


def test_the_table_is_markdown(measured: Path) -> None:
    done = told("table", measured)
    assert done.exit_code == 0, done.stderr
    assert f"**Operations, {TINY.name}**" in done.stdout
    assert re.search(r"^\| fast \| `semi_global` \| warp \| cpu \| 2 \| [\d.]+ [mµ]?s \|", done.stdout, re.MULTILINE)
    assert "- warp cuda:99: no such device here" in done.stdout
    rows = [line.count("|") for line in done.stdout.splitlines() if line.startswith("| fast |")]
    assert len(set(rows)) == 1
    presets = [f"The resident method, a light field after the other; preset {name}" for name in ("paper", "fast")]
    for title in ("The whole method from scratch", *presets, "The solver of the refinement"):
        assert f"**{title}" in done.stdout
    assert re.search(r"\| lbfgs \| .* \| [+-][\d.]+ % \|", done.stdout)


# --- comparison ---


def test_what_changed_is_found() -> None:
    slower = compare(run_of(record_of(1.0)), run_of(record_of(1.2)), 0.1)
    assert slower.slower == ["warp cpu operation 5x5x128x128 cold: 1 s → 1.2 s (+20 %)"]
    assert slower.fails
    faster = compare(run_of(record_of(1.2)), run_of(record_of(1.0)), 0.1)
    assert len(faster.faster) == 1
    assert not faster.fails
    assert compare(run_of(record_of()), run_of(record_of(error=1e-5)), 0.1).worse == [
        "warp cpu operation 5x5x128x128 cold: error relative 1e-06 → 1e-05"
    ]
    assert compare(run_of(record_of()), run_of(record_of(error=float("nan"))), 0.1).fails
    low, high = (replace(record_of(), errors={"energy": energy}) for energy in (100.0, 102.0))
    assert compare(run_of(low), run_of(high), 0.1).fails
    assert not compare(run_of(high), run_of(low), 0.1).fails
    failed = replace(record_of(), seconds=None, errors={}, failed="no memory")
    assert compare(run_of(record_of()), run_of(failed), 0.1).fails
    found = compare(run_of(record_of()), run_of(replace(record_of(), backend="taichi")), 0.1)
    assert [line.rpartition(": ")[2] for line in found.only] == ["only in the old one", "only in the new one"]
    assert found.compared == 0


def test_the_comparison_exits_with_what_it_found(tmp_path: Path) -> None:
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    results.save(run_of(record_of()), old)
    results.save(run_of(record_of(1.2), threads=1), new)
    done = told("compare", old, new)
    assert done.exit_code == 1
    assert "slower: warp cpu" in done.stdout
    assert done.stderr.startswith("warning: ")
    assert told("compare", old, new, "--threshold", "25").exit_code == 0

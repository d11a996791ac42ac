"""Worker processes: started, waited for, and what became of them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from benchmarks.jobs import Job, read_records, write_job
from benchmarks.machine import ROOT
from benchmarks.results import Record

_THREADS = ("LFGPU_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def environment(threads: int) -> dict[str, str]:
    """Environment of processes that use so many threads of the CPU."""
    return {**os.environ, **dict.fromkeys(_THREADS, str(threads))}


def probe(backend: str, env: Mapping[str, str], timeout: float) -> tuple[tuple[str, ...], str]:
    """The devices that a backend sees; where it cannot be loaded none, and the reason."""
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        out = Path(folder, "found.json")
        failure, _ = _finish(["benchmarks.probe", backend, str(out)], env, timeout)
        found = json.loads(out.read_text()) if not failure else {"reason": failure}
    return tuple(found.get("devices", ())), found.get("reason", "")


def run(job: Job, env: Mapping[str, str], timeout: float) -> list[Record]:
    """Measure a job. A process that fails or dies costs what it was at; another one goes on with the rest."""
    results: list[Record] = []
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        description, out = Path(folder, "job.json"), Path(folder, "records.jsonl")
        while (left := job.without({record.name for record in results})).names:
            out.unlink(missing_ok=True)
            write_job(left, description)
            failure, timed_out = _finish(["benchmarks.worker", str(description), str(out)], env, timeout)
            records = list(read_records(out))
            results += records
            missing = left.names[len(records) :]
            if timed_out:
                reasons = [failure, *["not reached: what came before took too long"] * len(missing)]
                results += [job.failed(name, why) for name, why in zip(missing, reasons, strict=False)]
            elif missing and not any(record.failed for record in records):
                results.append(job.failed(missing[0], failure or "ended without a result"))
    return results


def reason(code: int, errors: str) -> str:
    """What an exit code and what was written to stderr say about the end of a process."""
    if code < 0:
        name = signal.Signals(-code).name
        return f"ended by {name}" + (", as when memory runs out" if name == "SIGKILL" else "")
    lines = errors.strip().splitlines()
    return lines[-1][:200] if lines else f"ended with exit code {code}"


def _finish(arguments: list[str], env: Mapping[str, str], timeout: float) -> tuple[str, bool]:
    """Run a module: why it failed ("" if it did not), and whether that is that it took too long."""
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        try:
            done = subprocess.run(
                [sys.executable, "-m", *arguments],
                cwd=ROOT,
                env=env,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                timeout=timeout,
            )
        except subprocess.TimeoutExpired:
            return f"took longer than {timeout:g} s", True
        errors.seek(0)
        return (reason(done.returncode, errors.read()) if done.returncode else ""), False

"""Every operation of the kernels on a GPU against the reference, and a result file that names the commit.

CI has no GPU: it runs the CPU's kernels. What a GPU has of its own (the data term by tiles, the sweep, the direction of
L-BFGS, the sums over windows) is tested by the same matrix on a machine with a GPU, and this file is committed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Annotated, Any

import typer

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from benchmarks.options import check_out, known_backend, say
from benchmarks.results import FOLDER, write_json

ROOT = Path(__file__).parents[1]
FILES = (
    "tests/kernels/test_matrix.py",
    "tests/kernels/test_energy.py",
    "tests/kernels/test_memory.py",
    "tests/kernels/test_sweep_reference.py",
    "tests/kernels/test_reference_of_views.py",
    "tests/test_printed_equations.py",
    "tests/test_pipelines.py",
    "tests/test_depth_pipeline.py",
)
"""Tests of what a device computes; the other files of tests/kernels are about the reference, the checks or the CPU."""

_RAN = (0, 1, 5)  # what pytest exits with: all passed, some failed, a file had no tests for the device
RESULT = FOLDER / "gpu-parity.json"


def command(
    backend: Annotated[str, typer.Option(metavar="NAME")] = "warp",
    device: Annotated[str, typer.Option(metavar="DEVICE")] = "cuda:0",
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.json", show_default=False, help="Default: in results.")
    ] = RESULT,
) -> None:
    """Test every operation on a GPU against the reference; the file names the commit. Exits with 1 on failures."""
    check_out(out)
    for found in run(known_backend(backend), device):
        write_json(out, found)  # as far as it is
    if not found["passed"]:
        raise BenchmarkError(f"nothing could be tested on {backend} {device}: is the device there?")
    typer.echo(f"{found['passed']} passed, {found['skipped']} skipped, {len(found['failed'])} failed: {out}")
    if found["failed"]:
        raise typer.Exit(1)


def run(backend: str, device: str) -> Iterator[dict[str, Any]]:
    """Run the tests on a device, a file after the other.

    Yields after each file what was found until then: what passed, failed and was skipped, and the largest error of each
    operation. `files` are those that were run, `left` the others.
    """
    about = {"date": datetime.now(UTC).isoformat(timespec="seconds"), **machine.about("gpu_parity")}
    errors: dict[str, float] = {}
    count, skipped, failed, start = 0, 0, list[str](), perf_counter()
    for index, file in enumerate(FILES):
        say(f"{file} ({index + 1} of {len(FILES)})")
        cases = _cases(file, backend, device)
        for case in cases:
            for found in case.iter("property"):
                name, error = str(found.get("name")), float(str(found.get("value")))
                errors[name] = max(error, errors.get(name, 0.0))
        wrong = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
        failed += [str(case.get("name")) for case in wrong]
        skipped += sum(case.find("skipped") is not None for case in cases)
        count += len(cases)
        yield {
            **about,
            "backend": backend,
            "device": device,
            "seconds": round(perf_counter() - start, 1),
            "files": FILES[: index + 1],
            "left": FILES[index + 1 :],
            "passed": count - len(failed) - skipped,
            "skipped": skipped,
            "failed": list(failed),
            "errors": dict(sorted(errors.items())),
        }


def _cases(file: str, backend: str, device: str) -> list[ET.Element]:
    """Run a file of tests, and return the outcome of each."""
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", f"--backend={backend}", f"--device={device}", file]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), *_paths()]))}
        done = subprocess.run(
            [*command, "-p", "no:cacheprovider", f"--junitxml={report}"], cwd=ROOT, env=environment, check=False
        )
        if done.returncode not in _RAN or not report.is_file():
            raise BenchmarkError(
                f"the tests of {file} could not run on {backend} {device}; see what pytest said above."
            )
        return list(ET.parse(report).getroot().iter("testcase"))


def _paths() -> list[str]:
    """List the folders of PYTHONPATH, absolute: the tests run in another folder."""
    return [str(Path(path).resolve()) for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]

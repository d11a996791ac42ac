"""Every operation of the kernels on a GPU against the reference, and a result file that names the commit.

CI has no GPU: it runs the CPU's kernels. What a GPU has of its own (the data term by tiles, the sweep, the direction of
L-BFGS, the sums over windows) is tested by the same matrix on a machine with a GPU, and this file is committed.
"""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import atomic_write

ROOT = Path(__file__).parents[1]
TESTS = ("tests/kernels", "tests/test_printed_equations.py", "tests/test_pipelines.py", "tests/test_depth_pipeline.py")
RESULT = Path(__file__).with_name("results") / "gpu-parity.json"


def run(backend: str, device: str) -> dict[str, Any]:
    """Run the tests on a device; what passed, failed and was skipped, and the largest error of each operation."""
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", f"--backend={backend}", f"--device={device}", *TESTS]
        done = subprocess.run([*command, f"--junitxml={report}"], cwd=ROOT, check=False)
        if done.returncode not in (0, 1) or not report.is_file():
            raise BenchmarkError(f"the tests could not run on {backend} {device}; see what pytest said above.")
        cases = list(ET.parse(report).getroot().iter("testcase"))
    errors: dict[str, float] = {}
    for case in cases:
        for found in case.iter("property"):
            name, error = str(found.get("name")), float(str(found.get("value")))
            errors[name] = max(error, errors.get(name, 0.0))
    failed = [
        str(case.get("name")) for case in cases if case.find("failure") is not None or case.find("error") is not None
    ]
    skipped = sum(case.find("skipped") is not None for case in cases)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": machine.commit(),
        "machine": machine.describe(),
        "versions": machine.versions(),
        "backend": backend,
        "device": device,
        "passed": len(cases) - len(failed) - skipped,
        "skipped": skipped,
        "failed": failed,
        "errors": dict(sorted(errors.items())),
    }


def save(found: dict[str, Any], path: Path) -> None:
    """Write the result file whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

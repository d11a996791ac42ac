"""A whole backend with a fault goes through the matrix itself, in a run of pytest of its own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

# --- a whole broken backend, in the matrix itself ---

ROOT = Path(__file__).parents[2]


REGISTRATION = """
import lfgpu.kernels
from lfgpu import _backends

lfgpu.kernels.__path__.append({folder!r})
_backends._PACKAGES["copied"] = "numpy"
"""


OFFSETS, FLIPPED = "zip(residual, offsets, strict=True)", "zip(residual, offsets * (-1, 1), strict=True)"
"""In `splat_vjp`: the sign of du is the wrong one. The data term of the copy goes through it too."""


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} does not stand once in {path.name}: this test needs another fault"
    path.write_text(text.replace(old, new))


def outcomes_of_the_matrix(folder: Path, cases: str) -> dict[str, str]:
    """Outcome of each test of the matrix for the backend `copied`, a package in that folder."""
    (folder / "register_copied.py").write_text(REGISTRATION.format(folder=str(folder)))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    options = ("-p", "register_copied", "-p", "no:cacheprovider", "-rA", "--tb=no", "--backend=copied", "-k", cases)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(ROOT / "tests" / "kernels" / "test_matrix.py")],
        cwd=ROOT,
        env={**environment, "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        timeout=600,
    )
    found = re.findall(r"^(PASSED|FAILED|ERROR) \S+::(\S+)", done.stdout, re.MULTILINE)
    assert found, done.stdout + done.stderr
    return {test: outcome for outcome, test in found}


@pytest.mark.parametrize("fault", [False, True], ids=["right", "broken"])
def test_matrix_finds_a_new_backend_and_what_is_wrong_with_it(fault: bool, tmp_path: Path) -> None:
    copied = shutil.copytree(ROOT / "kernels" / "reference", tmp_path / "copied")
    edit(copied / "backend.py", 'name = "reference"', 'name = "copied"')
    if fault:
        edit(copied / "splat.py", OFFSETS, FLIPPED)
    outcomes = outcomes_of_the_matrix(tmp_path, "one-row-of-views or devices_are_names")
    wrong = {
        "test_operation_equals_the_reference[splat_vjp-one-row-of-views-copied-cpu]",
        "test_operation_equals_the_reference[data_term-one-row-of-views-copied-cpu]",
        "test_splat_vjp_is_the_adjoint_of_splat_jvp[one-row-of-views-copied-cpu]",
    }
    assert wrong <= outcomes.keys()
    assert len(outcomes) > 2 * len(wrong)
    assert outcomes == {test: "FAILED" if fault and test in wrong else "PASSED" for test in outcomes}

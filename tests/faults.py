"""Faults that tests once did not notice, and the test that does now: `python tests/faults.py` injects each in a copy.

It prints for each whether its test fails, and exits with 1 if one passes. It takes some minutes.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from shlex import split

from lfgpu.threads import get_threads

ROOT = Path(__file__).parents[1]
_COPIED = ("lfgpu", "kernels", "benchmarks", "tests", "pyproject.toml", "README.md", "docs")


@dataclass(frozen=True)
class Fault:
    """A piece of a file, what it is changed to, and the tests that must fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


# In `faults.txt`: a line `name | file | tests` for each fault, then lines of what is replaced (-) and what comes (+).
FAULTS = tuple(
    Fault(name, file, *("\n".join(line[2:] for line in piece.splitlines()) for piece in pieces), tuple(split(tests)))
    for name, file, tests, *pieces in re.findall(
        r"^(.+) \| (.+) \| (.+)\n((?:- .*\n)+)((?:\+ .*\n)+)",
        (ROOT / "tests/faults.txt").read_text("utf-8"),
        re.MULTILINE,
    )
)


def noticed(fault: Fault) -> bool:
    """Inject a fault into a copy of the project and return True if its tests fail there."""
    with tempfile.TemporaryDirectory() as folder:
        for name in _COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder)
        broken = Path(folder) / fault.file
        text = broken.read_text(encoding="utf-8")
        if fault.old not in text:
            raise SystemExit(f"{fault.name}: {fault.file} holds no {fault.old!r} any more.")
        broken.write_text(text.replace(fault.old, fault.new), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *fault.tests]
        environment = {**os.environ, "PYTHONPATH": folder, "LFGPU_THREADS": "1"}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            raise SystemExit(f"{fault.name}: pytest could not run.\n{done.stdout}{done.stderr}")
        return done.returncode == 1


def main() -> int:
    """Inject every fault whose name holds the first argument, or all; 1 if one is not noticed."""
    wanted = [fault for fault in FAULTS if not sys.argv[1:] or sys.argv[1] in fault.name]
    with ThreadPoolExecutor(get_threads()) as pool:
        found = []
        for fault, one in zip(wanted, pool.map(noticed, wanted), strict=True):
            found.append(one)
            print(f"{'noticed' if one else 'NOT NOTICED'}: {fault.name} ({fault.file})", flush=True)
    return int(not all(found))


if __name__ == "__main__":
    sys.exit(main())

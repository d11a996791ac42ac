"""Damaged files of every format, thousands of them: each is read, or refused with one sentence.

    python -m tests.io.fuzz --examples 30000 --seed 1 [--processes 2] [--summary counts.json]

Each example takes something that is read (`targets.py`: a small light field in one format, a raw capture, what lfgpu
writes, calibrated cameras), damages some of its files and reads it. Damage is blind (cut short, bytes changed, sizes
blown up, parts of other files put in, files lost, doubled, renamed, linked in circles) or knows the format
(`mutations.py`). Anything but what was to be read or a LightFieldError of one printable line is a failure, as are more
memory than `MEMORY`, more than `SECONDS` and a crash: examples run in processes of their own, whose address space is
limited. Everything happens in a temporary folder, many folders deep: no link and no "../.." leads out of it.

Thousands of small folders are made and removed; with a TMPDIR in memory (/dev/shm) that takes no disk.
"""

import argparse
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lfgpu.errors import LightFieldError
from lfgpu.printable import printable
from tests.io import mutations
from tests.io.targets import TARGETS

MEMORY = 256 << 20  # bytes on top of what Python and the libraries take; the samples are far below a megabyte
SPACE = 2 << 30  # of addresses: an allocation beyond it fails rather than being found out later
SECONDS, WAITING = 20, 20  # of work; and of nothing to do for the core: on a busy machine, others are waited for
BATCH = 250  # examples for each process
PATIENCE = 900  # seconds for each process
_LOOK = 5  # seconds between two looks at how long the core has had nothing to do
_DEEP = "a/b/c/d/e/f/g/h"  # more folders than any name in `_WORDS` leads up
_KNOWING = 0.5  # share of the damage that knows the format
_LONGEST = 1200  # characters of a sentence

_EXTREMES = [0, 1, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x10000, 100_000, 2**63 - 1, 2**64 - 1]
_WORDS = [b"nan", b"inf", b"-1", b"1e400", b"99999999999999999999", b"0", b"[]", b"\xff\xfe", b"\n", b"../../x", b'"']


class TooLong(BaseException):
    """An end of the time for an example: no `Exception`, which readers take for damage and refuse in a sentence."""


@dataclass
class Tally:
    """Counts of the examples by their outcome."""

    read: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    most_memory: int = 0
    inputs: Counter[str] = field(default_factory=Counter)
    """Of each kind of file."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Kinds of files that cannot be tried here, and why."""

    @property
    def tried(self) -> int:
        return sum(self.inputs.values())

    def summary(self) -> dict[str, Any]:
        """All of it, for JSON."""
        counts = {"inputs": self.tried, "read": self.read, "refused": self.refused, "failures": len(self.failures)}
        each = {"inputs_of_each": dict(sorted(self.inputs.items())), "left_out": self.left_out}
        return {**counts, "most_memory_mib": self.most_memory >> 20, **each, "what_failed": self.failures}


# --- damage ---


def _cut(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(0, len(data) + 1)) :]


def _flip(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 9))):
        data[int(rng.integers(len(data)))] = int(rng.integers(256))


def _flip_head(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(min(len(data), 256)))] = int(rng.integers(256))


def _blow_up(data: bytearray, rng: np.random.Generator) -> None:
    width = int(rng.choice([2, 4, 8]))
    at = int(rng.integers(min(len(data), int(rng.choice([64, 4096, 1 << 30])))))
    value = _EXTREMES[int(rng.integers(len(_EXTREMES)))] % (1 << (8 * width))
    data[at : at + width] = value.to_bytes(width, str(rng.choice(["little", "big"])))  # type: ignore[arg-type]


def _word(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.integers(len(data)))
    data[at : at + int(rng.integers(0, 8))] = _WORDS[int(rng.integers(len(_WORDS)))]


def _digits(data: bytearray, rng: np.random.Generator) -> None:
    places = [index for index in range(min(len(data), 2048)) if chr(data[index]).isdigit()]
    if places:
        at = places[int(rng.integers(len(places)))]
        data[at : at + 1] = str(rng.choice(["9", "0", "-", "99999", "1e9", ".", "9" * 30])).encode()


def _swap_ends(data: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(min(len(data), 1024)))
    data[start : start + 64] = data[start : start + 64][::-1]


def _repeat(data: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(len(data)))
    piece = data[start : start + int(rng.integers(1, 200))]
    data[start:start] = piece * int(rng.integers(1, 50))


def _blank(data: bytearray, rng: np.random.Generator) -> None:
    start, length = int(rng.integers(len(data))), int(rng.integers(1, 512))
    filling = int(rng.choice([0, 255]))
    data[start : start + length] = bytes([filling]) * len(data[start : start + length])


_OF_BYTES: list[Callable[[bytearray, np.random.Generator], None]] = [
    _cut, _flip, _flip_head, _flip_head, _blow_up, _blow_up, _word, _digits, _swap_ends, _repeat, _blank,
]  # fmt: skip


def _damage_folder(root: Path, files: list[Path], rng: np.random.Generator) -> None:
    victim, other = files[int(rng.integers(len(files)))], files[int(rng.integers(len(files)))]
    match int(rng.integers(8)):
        case 0:
            victim.unlink()
        case 1:
            if victim != other:
                victim.write_bytes(other.read_bytes())
        case 2:
            shutil.copy(victim, victim.with_name(f"{victim.stem}_1{victim.suffix}"))
        case 3:
            victim.rename(victim.with_name(f"ein Bild – 7 {victim.name}"))
        case 4:
            victim.unlink()
            victim.symlink_to(victim.name)  # a link to itself
        case 5:
            with suppress(FileExistsError):
                (victim.parent / "loop").symlink_to(root, target_is_directory=True)
        case 6:
            victim.unlink()
            victim.mkdir()
        case 7:
            victim.unlink()
            os.mkfifo(victim)


def damage(root: Path, rng: np.random.Generator) -> None:
    """Damage one to three files under a folder, or a file."""
    for _ in range(int(rng.integers(1, 4))):
        files = sorted(path for path in [root, *root.rglob("*")] if path.is_file() and not path.is_symlink())
        if not files:
            return
        if root.is_dir() and rng.random() < 0.2:
            _damage_folder(root, files, rng)
            continue
        # Each kind of file has the same share: descriptions are few, images many.
        suffix = str(rng.choice(sorted({file.suffix for file in files})))
        chosen = [file for file in files if file.suffix == suffix]
        victim = chosen[int(rng.integers(len(chosen)))]
        if rng.random() < _KNOWING and _damaged_knowingly(victim, rng):
            continue
        data = bytearray(victim.read_bytes())
        if data:
            _OF_BYTES[int(rng.integers(len(_OF_BYTES)))](data, rng)
            victim.write_bytes(data)


def _damaged_knowingly(victim: Path, rng: np.random.Generator) -> bool:
    """Take a file apart and put it together wrongly; return False if it cannot be taken apart."""
    before = victim.read_bytes()
    try:
        if victim.suffix == ".h5" or before[:19] == b"MATLAB 7.3 MAT-file":
            mutations.hdf5(victim, rng)
        else:
            victim.write_bytes(mutations.BY_SUFFIX[victim.suffix](before, rng))
    except Exception:  # it is damaged already
        victim.write_bytes(before)
        return False
    return True


# --- running ---


def one(name: str, source: Path, seed: int, within: Path) -> str:
    """Damage a copy of a sample in a folder and read it: "read", "refused", or what went wrong."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(dir=within) as folder:
        place = Path(folder) / source.name
        if source.is_dir():
            shutil.copytree(source, place)
        else:
            shutil.copy(source, place)
        damage(place, rng)
        try:
            with _limited(), warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                found = TARGETS[name].read(place, rng)
        except LightFieldError as error:
            text = str(error)
            if printable(text) != text or not text.endswith(".") or len(text) > _LONGEST:
                return f"not a sentence: {text!r}"
            result = "refused"
        except BaseException:
            return traceback.format_exc()
        else:
            views = getattr(found, "views", None)
            if views is not None and views.dtype == np.float32 and not np.isfinite(views).all():
                return "views that are not finite"
            result = "read"
        return result


@contextmanager
def _limited() -> Iterator[None]:
    """Raise TooLong in the block after `SECONDS` of work, or after `WAITING` in which nobody worked on this core."""
    before = _idle()

    def works(*_: object) -> None:
        raise TooLong(f"more than {SECONDS} seconds of work")

    def waits(*_: object) -> None:
        if _idle() - before > WAITING:
            raise TooLong(f"more than {WAITING} seconds of waiting")

    signal.signal(signal.SIGPROF, works)
    signal.signal(signal.SIGALRM, waits)
    signal.setitimer(signal.ITIMER_PROF, SECONDS, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, _LOOK, _LOOK)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)


def _idle() -> float:
    """Return the seconds since the start of the machine in which the cores of this process had nothing to do."""
    cores = {f"cpu{core}" for core in os.sched_getaffinity(0)}
    lines = (line.split() for line in Path("/proc/stat").read_text().splitlines())
    return sum(int(words[4]) for words in lines if words[0] in cores) / os.sysconf("SC_CLK_TCK") / len(cores)


def _batch(names: list[str], sources: dict[str, Path], seeds: range, log: Path, core: int) -> None:
    os.sched_setaffinity(0, {core})  # one thread each, of ffmpeg as well: addresses do not depend on the machine
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + SPACE, used + SPACE))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    within = log.with_suffix("") / _DEEP
    within.mkdir(parents=True, exist_ok=True)
    with threadpool_limits(1), log.open("a") as file, Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
        for seed in seeds:
            name = names[seed % len(names)]
            file.write(f"{seed}\t{name}\t")
            file.flush()  # before a crash
            file.write(repr(one(name, sources[name], seed, within)) + "\n")
        file.write(f"memory\t\t{1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)}\n")


@dataclass
class _Running:
    """A process that tries a batch."""

    process: multiprocessing.process.BaseProcess
    seeds: range
    log: Path
    core: int
    until: float = field(default_factory=lambda: time.monotonic() + PATIENCE)

    def count(self, tally: Tally) -> int:
        """Count what the log of a process that ended says; how many examples it is about.

        An example without a result ended the process.
        """
        self.process.join()
        tried = 0
        for line in self.log.read_text().splitlines() if self.log.exists() else []:
            seed, _, rest = line.partition("\t")
            name, _, result = rest.partition("\t")
            if seed == "memory":
                tally.most_memory = max(tally.most_memory, int(result))
                if int(result) > MEMORY:
                    tally.failures.append(f"{self.log.stem} and {BATCH} more: {int(result) >> 20} MiB")
                continue
            tried += 1
            tally.inputs[name] += 1
            if result == "'read'":
                tally.read += 1
            elif result == "'refused'":
                tally.refused += 1
            else:
                ended = f"the process ended with {self.process.exitcode}"
                tally.failures.append(f"seed {seed}, {name}: {result or ended}")
        self.log.unlink(missing_ok=True)
        shutil.rmtree(self.log.with_suffix(""), ignore_errors=True)
        return tried


def run(
    examples: int,
    seed: int = 0,
    names: Sequence[str] | None = None,
    processes: int = 1,
    show: Callable[[Tally], None] = lambda tally: None,
) -> Tally:
    """Try so many examples, from a seed on, and count what became of them; `show` sees the count now and then.

    What an example is depends on its seed and the names, not on the number of processes. Kinds of files whose
    libraries are missing are left out, and counted as such.
    """
    tally = Tally()
    fork = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as folder:
        sources = {}
        for name in sorted(names or TARGETS):
            place = Path(folder) / name
            place.mkdir()
            try:  # whole ones first: libraries are loaded before memory is counted
                source = TARGETS[name].write(place)
                TARGETS[name].read(source, np.random.default_rng(0))
            except (ImportError, LightFieldError) as error:
                if not isinstance(error, ImportError) and "install" not in str(error):
                    raise
                tally.left_out[name] = str(error)
                continue
            sources[name] = source
        chosen = list(sources)
        waiting = deque(
            range(start, min(start + BATCH, seed + examples)) for start in range(seed, seed + examples, BATCH)
        )
        cores = sorted(os.sched_getaffinity(0))
        free = deque(cores[slot % len(cores)] for slot in range(processes))
        running: list[_Running] = []
        try:
            while chosen and (waiting or running):
                while waiting and free:
                    seeds, core = waiting.popleft(), free.popleft()
                    log = Path(folder) / f"{seeds.start}.log"
                    process = fork.Process(target=_batch, args=(chosen, sources, seeds, log, core))
                    process.start()
                    running.append(_Running(process, seeds, log, core))
                wait([batch.process.sentinel for batch in running], timeout=1)
                for batch in list(running):
                    if batch.process.is_alive() and time.monotonic() < batch.until:
                        continue
                    if batch.process.is_alive():
                        batch.process.kill()
                    running.remove(batch)
                    free.append(batch.core)
                    tried = batch.count(tally)
                    if rest := batch.seeds[max(1, tried) :]:  # it ended at an example, or before the first
                        waiting.appendleft(rest)
                    show(tally)
        finally:
            for batch in running:
                batch.process.kill()
    return tally


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--examples", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", action="append", choices=sorted(TARGETS))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--summary", type=Path, help="write what was counted to this file, as JSON")
    arguments = parser.parse_args()
    began = time.monotonic()

    def show(tally: Tally) -> None:
        print(f"\r{tally.tried} inputs, {len(tally.failures)} failures", end="", file=sys.stderr, flush=True)

    tally = run(arguments.examples, arguments.seed, arguments.format, arguments.processes, show)
    print(file=sys.stderr)
    if arguments.summary:
        given = {key: getattr(arguments, key) for key in ("examples", "seed", "processes")}
        done = {**given, "seconds": round(time.monotonic() - began, 1), **tally.summary()}
        arguments.summary.write_text(json.dumps(done, indent=1) + "\n")
    for failure in tally.failures:
        print(failure.replace("\\n", "\n"))
    for name, reason in tally.left_out.items():
        print(f"{name} is left out: {reason}")
    print(
        f"{tally.tried} inputs: {tally.read} read, {tally.refused} refused, {len(tally.failures)} failures; "
        f"at most {tally.most_memory >> 20} MiB"
    )
    sys.exit(bool(tally.failures) or tally.tried < arguments.examples)


if __name__ == "__main__":
    main()

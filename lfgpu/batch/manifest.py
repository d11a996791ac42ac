"""The manifest of a batch: a line of JSON for whatever became of an item, the last one of an item being what holds."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from lfgpu.batch.items import Item
from lfgpu.config import Config
from lfgpu.errors import LightFieldError

MANIFEST_FILE = "manifest.jsonl"
DONE, FAILED = "done", "failed"

_LOCK_FILE = ".batch.lock"


def key_of(config: Config, options: Mapping[str, Any]) -> str:
    """What changes when any parameter does that results depend on."""
    text = json.dumps({"config": asdict(config), **options}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_manifest(folder: Path) -> dict[str, dict[str, Any]]:
    """What holds of each item, by name. Lines that a crash left unfinished are skipped: their items are done again.

    LightFieldError if the file is there and cannot be read.
    """
    path = folder / MANIFEST_FILE
    try:
        lines = path.read_bytes().splitlines()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise LightFieldError(f"{path} cannot be read: {error.strerror}.") from error
    found: dict[str, dict[str, Any]] = {}
    for line in lines:
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict) and isinstance(entry.get("item"), str):
            found[entry["item"]] = entry
    return found


def is_done(entry: Mapping[str, Any] | None, item: Item, parameters: str, input_key: str, out: Path) -> bool:
    """Whether an item need not be done again: it was done, from these files, with these parameters, and is there."""
    if entry is None or entry.get("status") != DONE:
        return False
    if (entry.get("parameters_key"), entry.get("input_key")) != (parameters, input_key):
        return False
    return _outputs_are_there(entry, out / item.name)


def standing(entries: Mapping[str, dict[str, Any]], out: Path) -> dict[str, dict[str, Any]]:
    """Those of a manifest's entries that still say what is there.

    Not those whose outputs are gone, nor those whose input has since been done under another name.
    """
    newest = {entry.get("input"): name for name, entry in sorted(entries.items(), key=lambda e: e[1].get("began", 0.0))}
    return {
        name: entry
        for name, entry in entries.items()
        if newest[entry.get("input")] == name and (entry.get("status") != DONE or _outputs_are_there(entry, out / name))
    }


def _outputs_are_there(entry: Mapping[str, Any], folder: Path) -> bool:
    sizes = entry.get("sizes")
    return sizes is not None and all(_size(folder / file) == size for file, size in sizes.items())


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return -1


class Manifest:
    """The manifest while a batch writes it; one batch at a time. Use it in a `with` block.

    Raises
    ------
    LightFieldError
        If another batch is at work there, or the file cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self._path, self._lock_path = folder / MANIFEST_FILE, folder / _LOCK_FILE
        self._file: IO[bytes] | None = None
        self._lock: IO[bytes] | None = None
        self.unwritten: list[bytes] = []
        """Lines that did not fit onto the disk; they are tried again with the next one."""

    def __enter__(self) -> Manifest:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = self._lock_path.open("ab")
            _lock(self._lock)
        except BlockingIOError as error:
            assert self._lock is not None
            self._lock.close()
            raise LightFieldError(
                f"another batch is writing to {self._path.parent}; wait until it is done, or choose another folder."
            ) from error
        except OSError as error:
            raise LightFieldError(f"{self._path.parent} cannot be written: {error.strerror or error}.") from error
        try:
            self._file = self._path.open("ab", buffering=0)
        except OSError as error:
            self._lock.close()
            raise LightFieldError(f"{self._path} cannot be written: {error.strerror or error}.") from error
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        assert self._file is not None
        assert self._lock is not None
        self._flush()
        self._file.close()
        self._lock.close()

    def add(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Write lines; what the disk has no room for is kept in `unwritten`."""
        self.unwritten += [json.dumps(entry, ensure_ascii=False).encode(errors="replace") + b"\n" for entry in entries]
        self._flush()

    def _flush(self) -> None:
        assert self._file is not None
        written = False
        while self.unwritten:
            line, end = self.unwritten[0], self._file.seek(0, os.SEEK_END)
            if end and not written and not self._ends_a_line(end):
                line = b"\n" + line  # a crash left half a line
            try:
                whole = self._file.write(line) == len(line)
            except OSError:
                whole = False
            if not whole:
                self._file.truncate(end)
                break
            self.unwritten.pop(0)
            written = True
        if written:
            os.fsync(self._file.fileno())

    def _ends_a_line(self, end: int) -> bool:
        with self._path.open("rb") as file:
            file.seek(end - 1)
            return file.read(1) == b"\n"


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed or the process ends, however; BlockingIOError if somebody else has."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError as error:
            raise BlockingIOError from error
        return
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

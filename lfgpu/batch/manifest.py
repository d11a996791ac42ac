"""The manifest of a batch: a line of JSON for each outcome of an item; the last line of an item is valid."""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Self

from lfgpu.batch.items import LOCK_FILE, MANIFEST_FILE, Item
from lfgpu.config import Config
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import not_waited_for

DONE, FAILED = "done", "failed"

_LONGEST_LINE = 1 << 24  # bytes; what goes on is damaged


def key_of(config: Config, options: Mapping[str, Any]) -> str:
    """Hash all parameters that results depend on."""
    text = json.dumps({"config": asdict(config), **options}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_manifest(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the newest entry of each item, by name, in the order of the lines; damaged lines are skipped.

    LightFieldError if the file cannot be read.
    """
    return _read(folder)[0]


def damaged_lines(folder: Path) -> int:
    """Count the damaged lines of a manifest: a crash or somebody else left them so."""
    return _read(folder)[1]


def _read(folder: Path) -> tuple[dict[str, dict[str, Any]], int]:
    path = folder / MANIFEST_FILE
    not_waited_for(path)
    found: dict[str, dict[str, Any]] = {}
    damaged = 0
    try:
        with path.open("rb") as file:
            for line in iter(lambda: file.readline(_LONGEST_LINE), b""):
                entry = _parsed(line)
                if entry is None:
                    damaged += 1
                elif "item" in entry:
                    found.pop(entry["item"], None)
                    found[entry["item"]] = entry  # the newest is the last one: clocks may jump
    except FileNotFoundError:
        return {}, 0
    except OSError as error:
        raise LightFieldError(f"{path} cannot be read: {error.strerror}.") from error
    return found, damaged


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Parse a line; None if it is damaged, that is not as `Manifest.add` writes it."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(entry, dict) or not all(fits(entry[key]) for key, fits in _FITS.items() if key in entry):
        return None
    return entry


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def _are(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """Make a check for tables whose values all pass a check."""
    return lambda value: isinstance(value, dict) and all(map(fits, value.values()))


_LARGEST = 1e300
_LATEST = 1e11  # seconds since 1970: two of them together are a date yet
_FITS: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(("item", "input", "status", "error", "worker"), lambda value: isinstance(value, str)),
    **dict.fromkeys(("began", "seconds"), lambda value: _is_number(value) and 0 <= value < _LATEST),
    "attempts": _is_number,
    "sizes": _are(_is_number),
    "times": _are(_is_number),
    "scale": _are(_is_number),
    "metrics": lambda value: value is None or _are(lambda score: score is None or _is_number(score))(value),
    "disparity_range": lambda value: isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)),
    "size": lambda value: isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)),
    **dict.fromkeys(
        ("notes", "remarks"), lambda value: isinstance(value, list) and all(isinstance(v, str) for v in value)
    ),
}
"""Checks of the entries that are used."""


def is_done(entry: Mapping[str, Any] | None, item: Item, parameters: str, input_key: str, out: Path) -> bool:
    """Tell whether an item is up to date: done from these files, with these parameters, and its outputs exist."""
    if entry is None or entry.get("status") != DONE:
        return False
    if (entry.get("parameters_key"), entry.get("input_key")) != (parameters, input_key):
        return False
    return _outputs_are_there(entry, out / item.name)


def standing(entries: Mapping[str, dict[str, Any]], out: Path) -> dict[str, dict[str, Any]]:
    """Select the entries of a manifest that still describe the output folder.

    Left out are entries whose outputs are missing, and those whose input was done again under another name.
    """
    newest = {entry.get("input"): name for name, entry in entries.items()}
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
    except (OSError, ValueError):  # a name that cannot be one is of no file, either
        return -1


class Manifest:
    """The manifest of a running batch, which no other batch can write meanwhile. Use it in a `with` block."""

    def __init__(self, folder: Path) -> None:
        self._path, self._lock_path = folder / MANIFEST_FILE, folder / LOCK_FILE
        self._file: IO[bytes] | None = None
        self._lock: IO[bytes] | None = None
        self.unwritten: list[Mapping[str, Any]] = []
        """Entries that could not be written because the disk was full; they are tried again with the next one."""

    def __enter__(self) -> Self:
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

    def __exit__(self, *_: object) -> None:
        assert self._file is not None
        assert self._lock is not None
        self._flush()
        self._file.close()
        self._lock.close()

    def add(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Write lines; if the disk is full, they are kept in `unwritten`."""
        self.unwritten += entries
        self._flush()

    def _flush(self) -> None:
        assert self._file is not None
        written = False
        while self.unwritten:
            line, end = _line(self.unwritten[0]), self._file.seek(0, os.SEEK_END)
            if end and not written and not self._ends_a_line(end):
                line = b"\n" + line  # a crash left an incomplete line
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


def _line(entry: Mapping[str, Any]) -> bytes:
    """Write an entry as a line of JSON in UTF-8; bytes of names that are not UTF-8 become escapes."""
    try:
        return json.dumps(entry, ensure_ascii=False).encode() + b"\n"
    except UnicodeEncodeError:
        return json.dumps(entry).encode() + b"\n"


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed or the process ends; BlockingIOError if another process has locked it."""
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

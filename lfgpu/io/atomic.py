"""Outputs are written whole or not at all: in a folder of their own first, moved into place when all went well.

A process holds a lock on that folder. The system takes it away from a process that ends, however it ends; so the next
one that writes there tells remnants from what others are writing, and removes them.
"""

import os
import re
import secrets
import shutil
from collections.abc import Collection, Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LEFT_OVER = ".lfgpu-"
"""Beginning of the names of the folders in which outputs lie until they are whole."""

_BYTES = 8  # of the rest of the name


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path to write one file to; it becomes `path` when the block ends without an exception.

    The temporary file lies in a folder next to the target and has its name, because writers choose formats by its
    suffix. Missing parent folders are made. On an exception nothing is left behind and a file that was there before is
    untouched. LightFieldError if the target cannot be written, also when the block fails with an OSError (a full disk).
    """
    target = _resolved(path)
    with _staged(target, target.parent) as temporary:
        if target.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        yield temporary
        temporary.replace(target)


@contextmanager
def atomic_folder(
    out: str | os.PathLike[str], *, ours: Collection[str] = (), mark: str | None = None
) -> Iterator[Path]:
    """Yield an empty temporary folder to write files to; it becomes `out` when the block ends without an exception.

    If `out` is there already, each file is moved into it, over a file of the same name; its other files stay. But if
    `out` holds a file `mark`, which tells that an earlier run wrote there, files of names that are `ours` and that the
    block did not write are removed after that. Otherwise as `atomic_write`.
    """
    target = _resolved(out)
    # A folder that is there may be a mount point, or writable when its parent is not: then staging happens inside it.
    exists = _exists(target) and target.is_dir()
    with _staged(target, target if exists else target.parent) as temporary:
        if target.exists() and not exists:
            raise NotADirectoryError(0, "it is a file, not a folder")
        temporary.mkdir()
        yield temporary
        if exists:
            _move_files(temporary, target, ours, mark)
            return
        try:
            temporary.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            _move_files(temporary, target, ours, mark)  # another process has made it meanwhile


def check_no_others(out: str | os.PathLike[str], new: Container[str], ours: re.Pattern[str]) -> None:
    """Raise LightFieldError if a folder holds other files of names that are `ours` than the `new` ones."""
    names = sorted(path.name for path in Path(out).iterdir()) if Path(out).is_dir() else []
    if other := next((name for name in names if ours.fullmatch(name) and name not in new), None):
        raise LightFieldError(f"{out} holds {other} of another light field or film; choose an empty folder.")


def check_no_inputs(outputs: Iterable[Path], inputs: Iterable[str | Path]) -> None:
    """Raise LightFieldError if an output would replace a file that is read."""
    files = {Path(file).resolve() for file in inputs}
    for place in outputs:
        if place.resolve() in files:
            raise LightFieldError(f"{place} is part of the input: it would be written over; choose another place.")


def check_writable(out: str | os.PathLike[str], *, folder: bool = True, source: Path | None = None) -> None:
    """Raise LightFieldError if `out` could not be written later, so that no long computation is lost; makes nothing.

    Nor may it be the `source` of what is to be written.
    """
    target = _resolved(out)
    if source is not None and os.path.realpath(source) == str(target):
        raise LightFieldError(f"{out}, which is the input, cannot be the output, too; name another place.")
    # A file is replaced by its sibling, a folder is written into: a folder has to be writable in both cases.
    place = target if folder else target.parent
    while not _exists(place):
        place = place.parent
    for name in target.relative_to(place).parts:
        _exists(place / name)  # raises for a name that is too long, which is not noticed below a missing folder
    if not folder and target.is_dir():
        raise LightFieldError(f"{target} cannot be written: it is a folder; name a file in it.")
    if not place.is_dir():
        raise LightFieldError(f"{target} cannot be written: {place} is a file, not a folder; choose another place.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise LightFieldError(f"{target} cannot be written: no permission to write in {place}; choose another place.")


def _resolved(path: str | os.PathLike[str]) -> Path:
    try:
        return named(path).resolve()
    except (OSError, RuntimeError) as error:
        raise LightFieldError(f"{os.fspath(path)} cannot be written: its links lead in a circle.") from error


@contextmanager
def _staged(target: Path, place: Path) -> Iterator[Path]:
    """Yield a free path below the folder `place`, which is made if missing; what it holds is gone after the block."""
    made: list[Path] = []
    try:
        for parent in reversed([folder for folder in (place, *place.parents) if not folder.exists()]):
            with suppress(FileExistsError):  # another process was quicker
                parent.mkdir()
                made.append(parent)
        with _own_folder(place) as folder:
            try:
                yield folder / target.name
            except LightFieldError as error:  # it may name a file there, which nobody will find
                error.args = (str(error).replace(f"{folder}{os.sep}", f"{place}{os.sep}"),)
                raise
    except BaseException as error:
        for parent in reversed(made):
            with suppress(OSError):  # somebody else may have put something there by now
                parent.rmdir()
        if isinstance(error, OSError):
            raise LightFieldError(f"{target} cannot be written: {error.strerror or error}.") from error
        raise


@contextmanager
def _own_folder(place: Path) -> Iterator[Path]:
    """Yield a new folder, which is gone after the block; no other process takes it for a remnant before."""
    _remove_remnants(place)
    lock = None
    while lock is None:
        folder = place / f"{LEFT_OVER}{secrets.token_hex(_BYTES)}"
        folder.mkdir()
        with suppress(FileNotFoundError, BlockingIOError):  # it was taken for one before it was locked
            lock = _locked(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock >= 0:
            os.close(lock)


@cache  # once in each folder: it may hold many files
def _remove_remnants(place: Path) -> None:
    """Remove what processes left that were killed while they wrote to a folder."""
    for folder in place.glob(LEFT_OVER + "[0-9a-f]" * 2 * _BYTES):
        with suppress(OSError):  # somebody is writing there, or it belongs to others
            lock = _locked(folder)
            if lock >= 0:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)


def _locked(folder: Path) -> int:
    """Lock a folder, and return the descriptor that keeps it locked; -1 where folders cannot be locked.

    BlockingIOError if another process has locked it, FileNotFoundError if it has gone meanwhile.
    """
    if fcntl is None:
        return -1
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.stat()
    except (BlockingIOError, FileNotFoundError):
        os.close(descriptor)
        raise
    except OSError:  # a file system without locks
        os.close(descriptor)
        return -1
    return descriptor


def _move_files(source: Path, target: Path, ours: Collection[str], mark: str | None) -> None:
    new = {path.name for path in source.iterdir()}
    old = [target / name for name in ours if name not in new] if mark and (target / mark).is_file() else []
    for path in source.rglob("*"):  # all or nothing: what stands in the way is found before the first move
        place = target / path.relative_to(source)
        if place.exists() and place.is_dir() != path.is_dir():
            raise IsADirectoryError(None, f"{place} is in the way")
    for folder, _, files in os.walk(source):
        destination = target / Path(folder).relative_to(source)
        destination.mkdir(exist_ok=True)
        for file in files:
            Path(folder, file).replace(destination / file)
    for path in old:
        if path.is_file() or path.is_symlink():
            path.unlink()


def _exists(path: Path) -> bool:
    """Tell whether a path is there; LightFieldError if it cannot be, because a name is too long or links are a circle.

    In a folder that may not even be looked into nothing is there: the search goes on above it.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return False
    except OSError as error:
        raise LightFieldError(f"{path} cannot be written: {error.strerror}.") from error
    return True

"""What there is to do: light fields in folders, behind patterns, and frames of sequences, each with a name."""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfgpu.errors import LightFieldError
from lfgpu.io.folders import entries, image_files, natural_order
from lfgpu.io.formats import recognise
from lfgpu.io.images import IMAGE_SUFFIXES
from lfgpu.io.numpy_file import holds_views

_LOOSE = ("camera-row", "named-views")  # formats of folders that any images may be taken for, also those a folder below
_OF_OUTPUTS = ("manifest.jsonl", "result.npz")  # what tells folders of outputs from inputs


@dataclass(frozen=True)
class Item:
    """One light field to be estimated.

    Parameters
    ----------
    name
        Its folder below that of the outputs.
    source
        Where it is read from.
    sequence
        What sequence it is a frame of; "" if of none.
    """

    name: str
    source: str
    sequence: str = ""


def find_items(
    inputs: Sequence[str], *, sequence: bool, format_name: str | None = None, leave_out: Path | None = None
) -> tuple[list[Item], list[Path]]:
    """The light fields that inputs name, and the folders in which none was found.

    Parameters
    ----------
    inputs
        Light fields, folders that hold some at any depth, or patterns (`*`, `?`, `[..]`, `**`) of these.
    sequence
        Whether light fields in one folder are the frames of a sequence, in the order of the numbers in their names.
    format_name
        Format of all light fields; each path that an input names is then one. None finds light fields by their kinds.
    leave_out
        The folder of the outputs, which is not looked into.

    Raises
    ------
    LightFieldError
        If an input names nothing that exists, or nothing is found at all.
    """
    everything: list[Path] = []
    search = _Search(None if leave_out is None else leave_out.resolve())
    for path in (path for text in inputs for path in _matches(text) if path.resolve() != search.excluded):
        if format_name is not None or not path.is_dir():
            everything.append(path)
        else:
            everything += search.below(path)
    paths = sorted({path.absolute() for path in everything}, key=lambda path: natural_order(str(path)))
    if not paths:
        raise LightFieldError(f"no light field was found in {', '.join(inputs)}; give folders of views, or of such.")
    names = _names(paths)
    return [Item(names[path], str(path), str(path.parent) if sequence else "") for path in paths], search.barren


def fingerprint(source: str, *, leave_out: Path | None = None) -> str:
    """What changes when a light field's files do: from their names, sizes and times, not from what is in them.

    The folder `leave_out`, where outputs go, is not looked into.
    """
    root = Path(source)
    digest = hashlib.sha256()
    files = sorted(_files(root, None if leave_out is None else leave_out.resolve())) if root.is_dir() else [root]
    for file in files:
        try:
            found = file.stat()
            digest.update(f"{file.relative_to(root)}\0{found.st_size}\0{found.st_mtime_ns}\0".encode(errors="replace"))
        except OSError as error:
            digest.update(f"{file}\0{error.errno}\0".encode(errors="replace"))
    return digest.hexdigest()[:16]


def _files(folder: Path, excluded: Path | None) -> Iterable[Path]:
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if Path(place, name).resolve() != excluded]
        yield from (Path(place, name) for name in names)


def _matches(text: str) -> list[Path]:
    if Path(text).exists():
        return [Path(text)]
    found = sorted(map(Path, glob.glob(text, recursive=True)))  # noqa: PTH207 - patterns may be absolute
    if not found:
        raise LightFieldError(f"{text} does not exist, and as a pattern it matches nothing; give what is to be done.")
    return found


class _Search:
    """Looks for light fields in folders, each of which is looked into once, however many links lead there.

    Parameters
    ----------
    excluded
        A folder that is not looked into.
    """

    def __init__(self, excluded: Path | None) -> None:
        self.excluded, self.barren = excluded, list[Path]()
        """`barren`: the folders in which none was found."""
        self._seen: set[Path] = set()

    def below(self, folder: Path) -> list[Path]:
        """The folder, if it is a light field, or those inside; none if the folder holds outputs."""
        kind, real = _kind(folder), folder.resolve()
        if real in self._seen:
            return []
        self._seen.add(real)
        if kind is not None and kind not in _LOOSE:
            return [folder]
        if any((folder / name).is_file() for name in _OF_OUTPUTS):
            return []
        before, inside = len(self.barren), list(self._inside(folder))
        own = len(image_files(folder)) if kind is not None else 0
        if own > 1 and not any(_outweighs(found, own) for found in inside):
            del self.barren[before:]
            return [folder]
        if not inside:
            self.barren.append(folder)
        return inside

    def _inside(self, folder: Path) -> Iterable[Path]:
        for entry in entries(folder):
            if entry.resolve() == self.excluded:
                continue
            if entry.is_dir():
                yield from self.below(entry)
            elif _kind(entry) is not None and holds_views(entry):
                yield entry


def _kind(path: Path) -> str | None:
    """The name of its format; None if it is no light field."""
    try:
        return recognise(path)[0].name
    except LightFieldError:
        return None


def _outweighs(found: Path, own: int) -> bool:
    """Whether a light field inside a folder says that its `own` images are none: thumbnails, or a picture of it."""
    if found.is_dir():
        return _kind(found) not in _LOOSE or len(image_files(found)) > own
    return found.suffix.lower() not in IMAGE_SUFFIXES


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """The last parts of paths, as many as it takes to tell all from each other."""
    names, parts = {path: path.name for path in paths}, 1
    while True:
        counts = Counter(_comparable(name) for name in names.values())
        same = [path for path, name in names.items() if counts[_comparable(name)] > 1]
        parts += 1
        longer = {path: "/".join(path.parts[-parts:]).lstrip("/") for path in same}
        if not same or all(longer[path] == names[path] for path in same):
            return names
        names.update(longer)


def _comparable(name: str) -> str:
    return name.casefold()  # of file systems to which these are the same

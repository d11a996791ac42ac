"""Items of a batch: light fields in folders, from patterns, and frames of sequences."""

import errno
import glob
import hashlib
import os
import secrets
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from lfgpu.errors import LightFieldError
from lfgpu.io import DEPTH_FILE, DISPARITY_FILE, RESULT_FILE, stanford
from lfgpu.io.atomic import LEFT_OVER
from lfgpu.io.description import named_by
from lfgpu.io.folders import IMAGE_SUFFIXES, entries, image_files, natural_order
from lfgpu.io.formats import ANY_IMAGES, FORMATS, inside, several_in
from lfgpu.io.map_formats import REPORT_FILE
from lfgpu.io.naming import families
from lfgpu.io.numbered import frames_of, holds_cameras
from lfgpu.io.numpy_file import holds_views
from lfgpu.io.texts import read_json_or_toml
from lfgpu.printable import printable

MANIFEST_FILE = "manifest.jsonl"
LOCK_FILE = ".batch.lock"
VIEW_FILE, PREVIEW_FILE, ERROR_FILE = "view.jpg", "preview.png", "error.png"
"""Pictures of an item for the page: the reference view, the map, and its error where there is ground truth."""
ITEM_FILES = (DISPARITY_FILE, DEPTH_FILE, RESULT_FILE, VIEW_FILE, PREVIEW_FILE, ERROR_FILE, REPORT_FILE)
"""All files that the folder of an item may hold; those of an earlier run that a new one lacks are removed."""
OWN = (MANIFEST_FILE, LOCK_FILE, REPORT_FILE)
"""The files that lie beside the folders of the items."""


_MOST = 200_000  # files of one light field or sequence
_LOOSE = ("camera-row", "named-views")  # formats that match any folder of images
_OF_OUTPUTS = (MANIFEST_FILE, RESULT_FILE)  # files that mark a folder as an output


@dataclass(frozen=True)
class Item:
    """One light field of a batch."""

    name: str  # its folder below the output folder
    source: str  # the path that it is read from
    sequence: str = ""  # the sequence that it is a frame of
    frame: int | None = None  # index of its time where the path holds several times for each camera


def find_items(
    inputs: Sequence[str],
    *,
    sequence: bool,
    format_name: str | None = None,
    pattern: str | None = None,
    frame: int | None = None,
    leave_out: Path | None = None,
) -> tuple[list[Item], list[Path]]:
    """Find the light fields that inputs name, and the folders in which there is none.

    Inputs are light fields, folders that hold light fields at any depth, or patterns (`*`, `?`, `[..]`, `**`) of these.
    With `sequence`, the light fields of a folder are frames, in natural order of their names. With `format_name` or
    `pattern`, each path that an input names is a light field. The output folder `leave_out` is not searched. Whatever
    cannot be looked at is one of the items: who reads it says what is wrong. LightFieldError if an input does not exist
    or nothing is found.
    """
    everything: list[Path] = []
    search = _Search(None if leave_out is None else real(leave_out))
    named = [path for text in inputs for path in _matches(text)]
    for path in (path for path in named if real(path) != search.excluded):
        if format_name is not None or pattern is not None or not _is_folder(path):
            everything.append(path)
        else:
            everything += search.below(path)
    paths = sorted({path.absolute() for path in everything}, key=lambda path: natural_order(str(path)))
    if not paths and any(real(path) == search.excluded for path in named):
        raise LightFieldError(
            f"-o names {leave_out}, which is the input; name another folder for the outputs, which may lie inside it."
        )
    if not paths:
        raise LightFieldError(
            f"no light field was found in {', '.join(inputs)}; give light fields, or folders that hold some."
        )
    names = _names(paths)
    items = []
    for path in paths:
        times = _times(path, pattern) if frame is None and format_name in (None, *ANY_IMAGES) else 1
        if times == 1:
            items.append(Item(names[path], str(path), str(path.parent) if sequence else ""))
        else:
            of = str(path) if sequence else ""
            items += [Item(f"{names[path]}/{time:04d}", str(path), of, time) for time in range(times)]
    return items, search.barren


def _times(path: Path, pattern: str | None) -> int:
    """Count the times that a folder of numbered images holds for each camera; 1 for anything else."""
    try:
        if pattern is None and recognised(path) not in ANY_IMAGES:
            return 1
        return frames_of(path, pattern)
    except LightFieldError:  # whoever reads it says what is wrong
        return 1


def fingerprint(source: str, *, leave_out: Path | None = None) -> str:
    """Hash names, sizes and times of the files of a light field, also of those that a description names.

    Those in the output folder `leave_out` are left out. Where there are more than can be looked at, such as on a whole
    disk that a description or a link names, the hash is a new one each time.
    """
    excluded = None if leave_out is None else real(leave_out)
    digest = hashlib.sha256()
    for place in (Path(source), *named_by(Path(source))):
        files = list(islice(_files(place, excluded), _MOST + 1)) if _is_folder(place) else [place]
        if len(files) > _MOST:
            return secrets.token_hex(8)
        for file in sorted(files):
            try:
                found = file.stat()
                text = f"{file.relative_to(place)}\0{found.st_size}\0{found.st_mtime_ns}\0"
            except OSError as error:
                text = f"{file}\0{error.errno}\0"
            except ValueError:  # a zero byte in a name, which no file has
                continue
            digest.update(text.encode(errors="surrogateescape"))
    return digest.hexdigest()[:16]


def _files(folder: Path, excluded: Path | None) -> Iterable[Path]:
    """Yield the files of a folder at any depth; folders that links lead to are looked into as well, each once."""
    seen = {excluded, real(folder), *real(folder).parents}
    for place, folders, names in os.walk(folder, followlinks=True):
        for name in sorted(folders):
            where = real(Path(place, name))
            if where in seen:
                folders.remove(name)
            seen.add(where)
        yield from (Path(place, name) for name in names)


def _matches(text: str) -> list[Path]:
    try:
        if Path(text).exists():
            return [Path(text)]
    except OSError:  # in a folder that may not be looked into
        return [Path(text)]
    found = sorted(map(Path, glob.glob(text, recursive=True)))  # noqa: PTH207 - patterns may be absolute
    if not found:
        raise LightFieldError(
            f"{text} does not exist, and matches nothing as a pattern; give light fields, folders or patterns."
        )
    return found


class _Search:
    """A search for light fields in folders but `excluded`, each of them once, however many links lead to it."""

    def __init__(self, excluded: Path | None) -> None:
        self.excluded, self.barren = excluded, list[Path]()
        """`barren`: the folders in which no light field was found."""
        self._seen: set[Path] = set()

    def below(self, folder: Path) -> list[Path]:
        """Return the folder if it is a light field, else the light fields inside; nothing if it holds outputs."""
        where = real(folder)
        if where in self._seen:
            return []
        self._seen.add(where)
        try:
            return self._looked_into(folder)
        except (LightFieldError, OSError):  # it cannot be listed
            return [folder]

    def _looked_into(self, folder: Path) -> list[Path]:
        fault, kind = None, None
        try:
            kind = recognised(folder)
        except LightFieldError as error:  # such as a view that is a link to nowhere
            fault = error
        lies_below = kind == "stanford" and stanford.folder_of(folder) != folder  # others may lie beside it
        if kind is not None and kind not in _LOOSE and not lies_below:
            return [folder]
        if kind in _LOOSE and holds_cameras(folder):
            return [folder]
        has_views = bool(families(image_files(folder), folder))  # numbered: somebody wrote results beside them
        if any((folder / name).is_file() for name in (_OF_OUTPUTS[:1] if has_views else _OF_OUTPUTS)):
            return []
        before, inside = len(self.barren), list(self._inside(folder))
        own = len(image_files(folder)) if kind is not None else 0
        if own > 1 and not any(_outweighs(found, own) for found in inside):
            del self.barren[before:]
            return [folder]
        if not inside and (fault is not None or kind is not None):
            return [folder]
        if not inside:
            self.barren.append(folder)
        return inside

    def _inside(self, folder: Path) -> Iterable[Path]:
        for entry in entries(folder):
            if real(entry) == self.excluded:
                continue
            if _is_folder(entry):
                yield from self.below(entry)
            elif _is_circle(entry) or (_kind(entry) and holds_views(entry) and not _without_light_field(entry)):
                yield entry


def real(path: Path) -> Path:
    """Resolve the links of a path; if they go in a circle, or may not be looked at, return the path itself."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _is_circle(path: Path) -> bool:
    """Tell whether a link leads back to itself."""
    try:
        path.stat()
    except OSError as error:
        return error.errno == errno.ELOOP
    return False


def _kind(path: Path) -> str | None:
    """Name the format of a file; None if it is no light field, or cannot be looked at."""
    try:
        return recognised(path)
    except (LightFieldError, OSError):
        return None


def recognised(path: Path) -> str | None:
    """Name the format of a path; None if it has none, or holds several. LightFieldError if it cannot be looked at."""
    found = next((entry for entry in FORMATS if entry.recognise(path) is not None), None)
    if found is None or several_in(path, found) is not None:
        return None
    return found.name


def _without_light_field(file: Path) -> bool:
    """Tell whether a file of a known format says that it holds other things: a focal stack, a depth table, a log."""
    try:
        if recognised(file) == "lightfield-toml":
            table = read_json_or_toml(file)
            return not isinstance(table, dict) or not ("source" in table or isinstance(table.get("views"), list))
        return inside(file, format=recognised(file) or "").no_depth is not None
    except LightFieldError:  # damaged: whoever reads it says so
        return False


def _outweighs(found: Path, own: int) -> bool:
    """Tell whether a light field inside a folder means that its `own` images are thumbnails, not views."""
    if found.is_dir():
        return _kind(found) not in _LOOSE or len(image_files(found)) > own
    return found.suffix.lower() not in IMAGE_SUFFIXES


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Name paths by their last parts, as many as tell all from each other: places below the folder of outputs.

    What is not printable in them is written out, so that manifests, pages and folders have the same names.
    """
    split = {path: _parts(path) for path in paths}
    names, parts = {path: split[path][-1] for path in paths}, 1
    while True:
        counts = Counter(_comparable(name) for name in names.values())
        same = [path for path, name in names.items() if counts[_comparable(name)] > 1]
        parts += 1
        longer = {path: "/".join(split[path][-parts:]) for path in same}
        if not same or all(longer[path] == names[path] for path in same):
            return names
        names.update(longer)


def _parts(path: Path) -> list[str]:
    """Split an absolute path into parts without "..", which would lead out of the folder of outputs."""
    found = [printable(part) for part in Path(os.path.normpath(path)).parts if part != path.anchor]
    taken = [part in OWN or part.startswith(LEFT_OVER) for part in found]  # for files of the batch itself
    return [f"_{part}" if is_taken else part for part, is_taken in zip(found, taken, strict=True)] or ["root"]


def _comparable(name: str) -> str:
    return name.casefold()  # some file systems ignore case

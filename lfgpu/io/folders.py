"""Contents of folders, with the file system's complaints turned into sentences."""

import re
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import read_as

IMAGE_SUFFIXES = frozenset({".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".ppm", ".pgm", ".exr"})
"""Suffixes, in lower case, of the files that are taken for images."""

_LISTED = 3


def listed(paths: Sequence[Path]) -> str:
    """Return the names of the first few paths and how many there are besides: "a.png, b.png, c.png and 5 more"."""
    more = f" and {len(paths) - _LISTED} more" if len(paths) > _LISTED else ""
    return ", ".join(path.name for path in paths[:_LISTED]) + more


def natural_order(text: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts names as people count: frame_2 before frame_10.

    Runs of the digits 0 to 9, and of decimal digits of other scripts, count as numbers; signs such as ² do not.
    """
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", text) if part]


def image_files(folder: Path) -> list[Path]:
    """Return the image files of a folder by their suffix, sorted by name; hidden files are left out.

    LightFieldError if one is a link that leads nowhere: without it the rest could pass for a smaller light field.
    """
    images = _select(folder, lambda entry: entry.suffix.lower() in IMAGE_SUFFIXES and _shown(entry))
    for image in images:
        if image.is_symlink() and not image.exists():
            raise LightFieldError(f"{image} is a link that leads nowhere; remove it or put the file there.")
    return [image for image in images if image.is_file()]


def not_waited_for(path: Path, what: str = "a file") -> None:
    """Raise LightFieldError for a pipe, a socket or a device: opening it would wait for somebody, or never end."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # what is missing or locked is said by who opens it
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise LightFieldError(f"{path} is neither a file nor a folder; give {what}.")


def head(path: Path, count: int) -> bytes:
    """Return the first bytes of a regular file; none of anything else."""
    with read_as(path):
        if not path.is_file():  # opening a pipe would wait for somebody to write into it
            return b""
        with path.open("rb") as file:
            return file.read(count)


def sub_folders(folder: Path) -> list[Path]:
    """Return the direct sub-folders of a folder, sorted by name; hidden ones are left out."""
    return _select(folder, lambda entry: _shown(entry) and entry.is_dir())


def entries(folder: Path) -> list[Path]:
    """Return all that a folder shows, sorted by name."""
    return _select(folder, _shown)


def _shown(entry: Path) -> bool:
    return not entry.name.startswith(".")


def _select(folder: Path, wanted: Callable[[Path], bool]) -> list[Path]:
    try:
        return [entry for entry in sorted(folder.iterdir()) if wanted(entry)]
    except OSError as error:
        raise LightFieldError(f"{folder} cannot be listed: {error.strerror}.") from error

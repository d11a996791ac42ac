"""Folders that hold several light fields: none of them may be taken for the folder without a word."""

from collections.abc import Callable, Sequence
from pathlib import Path

from lfgpu.errors import LightFieldError
from lfgpu.io import lenslet, lytro
from lfgpu.io.folders import entries, image_files, listed, sub_folders

ANY_IMAGES = ("camera-row", "named-views", "row-folders")
"""Formats that any folder of images may be taken for: thumbnails, masks, maps of each view."""


def sentence(folder: Path, chosen: str, kind: Callable[[Path], str | None]) -> str | None:
    """Describe a folder that holds several light fields and is taken for one of the format `chosen`; else None."""
    images = image_files(folder)
    if images:
        if chosen in ANY_IMAGES and all(lenslet.recognise(image) for image in {images[0], images[-1]}):
            return _sentence(folder, images, "raw captures")
        return None
    kinds = {inside: kind(inside) for inside in sub_folders(folder)}
    found = [inside for inside, its in kinds.items() if its is not None]
    if len(found) > 1 and any(its not in ANY_IMAGES for its in kinds.values() if its is not None):
        return _sentence(folder, found, "light fields")
    return None


def check_no_captures(path: Path) -> None:
    """Raise LightFieldError if a path that is no light field is a folder of captures."""
    if not path.is_dir():
        return
    files = [entry for entry in entries(path) if entry.is_file()]
    if captures := [file for file in files if lenslet.recognise(file) or lytro.recognise(file)]:
        raise LightFieldError(_sentence(path, captures, "captures"))


def _sentence(folder: Path, them: Sequence[Path], what: str) -> str:
    return (
        f"{folder} holds {len(them)} {what}, each a light field of its own ({listed(them)}): give one of them, or the "
        "folder to lfgpu batch."
    )

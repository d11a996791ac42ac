"""The formats of light fields that can be read: one table, an entry each, the first that recognises a path reads it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any

from lfgpu.data import Inside, LightField
from lfgpu.data.light_field_checks import check_whole, named
from lfgpu.data.mapping import forget
from lfgpu.errors import LightFieldError
from lfgpu.io import (
    blender,
    description,
    hci,
    hci_old,
    lenslet,
    lftoolbox,
    lytro,
    numbered,
    numpy_file,
    plenopticam,
    sheets,
    stanford,
    tiff_stack,
    video,
)
from lfgpu.io.arrays import check_axes
from lfgpu.io.brightness import with_white, without_black_corners
from lfgpu.io.contradictions import contradictions
from lfgpu.io.damage import check_fetched
from lfgpu.io.disk import on_disk, wanted_on_disk
from lfgpu.io.flips import ORDERS, check_flip, flipped, reordered, transposed
from lfgpu.io.folders import IMAGE_SUFFIXES, entries, head, image_files, listed, not_waited_for, sub_folders
from lfgpu.io.grid import Needed, in_part
from lfgpu.io.taken import check_unit, in_unit, told


@dataclass(frozen=True)
class Format:
    """One entry of the table."""

    name: str  # the word by which users choose it: lower case, hyphens
    description: str  # one line for lists and help, without a full stop
    recognise: Callable[[Path], str | None]
    """Says why a path that exists is of this format ("it is a folder with ..."), or None. Looks at names and magic,
    and at what is in a file only where a quick look can be sure."""
    read: Callable[..., LightField]
    """Reads a path that exists, given the keywords in `takes` that users gave. Raises LightFieldError with a sentence
    that names the file at fault: if it is missing, damaged, of another kind, claims more than it can hold, contradicts
    others, or needs a library that is not there."""
    extra: str | None = None  # the extra of the package that (some files of) the format needs
    takes: tuple[str, ...] = ()  # the keywords of `lfgpu.read` that have a meaning for it, "allow_missing" among them
    inside: Callable[[Path], Inside] | None = None
    """Describes what its files hold beside views; None where that is nothing."""
    looks_below: bool = False  # true if a folder is of this format where only one of its sub-folders has the views


ANY_IMAGES = ("camera-row", "named-views", "row-folders")
"""Formats that any folder of images may be taken for: thumbnails, masks, maps of each view."""

_MISSING = "allow_missing"


def _numbered(name: str, about: str, *takes: str) -> Format:
    """Return a kind of folder of pictures whose names have numbers."""
    return Format(
        name=name,
        description=about,
        recognise=partial(numbered.recognise, kind=name),
        read=partial(numbered.read_numbered, kind=name),
        looks_below=True,
        takes=(_MISSING, "pattern", "frame", *takes),
    )


FORMATS: tuple[Format, ...] = (
    # Those that are named more distinctly come first: the first one that recognises a path is taken.
    Format(
        name="blender",
        description="what the IDLab light field add-on of Blender rendered: lightfield.json, exr/ or png/",
        recognise=blender.recognise,
        read=blender.read_blender,
        extra="exr",
        takes=(_MISSING,),
    ),
    Format(
        name="lightfield-toml",
        description="a description lightfield.toml (or .json) of any array of cameras",
        recognise=description.recognise,
        read=partial(
            description.read_description,
            read=lambda path, **options: read(path, lazy=wanted_on_disk(), **options),  # by this very table
        ),
        takes=(_MISSING,),
    ),
    Format(
        name="hci",
        description="HCI 4D Light Field Benchmark: a folder with input_Cam000.png ... and parameters.cfg",
        recognise=hci.recognise,
        read=hci.read_hci,
        takes=(_MISSING,),
    ),
    Format(
        name="hci-export",
        description="a folder exported from the old HCI light fields: lf/00_00.png ..., attributes.dat, depth.bin",
        recognise=hci_old.recognise_export,
        read=hci_old.read_hci_export,
        takes=(_MISSING, "unit"),
    ),
    Format(
        name="stanford",
        description="Stanford Light Field Archive: a folder of out_ROW_COLUMN_Y_X.png",
        recognise=stanford.recognise,
        read=stanford.read_stanford,
        looks_below=True,
    ),
    Format(
        name="plenopticam",
        description="an export of PlenoptiCam: a folder viewpoints_9px with images named by row and column",
        recognise=plenopticam.recognise,
        read=plenopticam.read_plenopticam,
        takes=(_MISSING,),
    ),
    Format(
        name="lftoolbox",
        description="a MATLAB file of the Light Field Toolbox with LF [t, s, v, u, c]",
        recognise=lftoolbox.recognise,
        read=lftoolbox.read_lftoolbox,
        takes=("axes",),
        extra="hdf5",
    ),
    Format(
        name="numpy",
        description="a NumPy file (.npy, .npz) of views [v, u, y, x, c] or [n, y, x, c]",
        recognise=numpy_file.recognise,
        read=numpy_file.read_numpy,
        takes=("grid", "order", "axes"),
    ),
    Format(
        name="tiff-stack",
        description="a TIFF file with a page for each view",
        recognise=tiff_stack.recognise,
        read=tiff_stack.read_tiff_stack,
        extra="tiff",
        takes=("grid", "order", "axes"),
    ),
    Format(
        name="mosaic",
        description="an image of microlenses, a block of pixels each (ESLF)",
        recognise=partial(sheets.recognise, word=sheets.ESLF),
        read=sheets.read_mosaic,
        takes=("grid", "order"),
    ),
    Format(
        name="tiles",
        description="an image of all views side by side",
        recognise=partial(sheets.recognise, word="tiles"),
        read=sheets.read_tiles,
        takes=("grid", "order"),
    ),
    Format(
        name="video",
        description="a video of a camera that moves along a row",
        recognise=video.recognise,
        read=video.read_video,
        extra="video",
        takes=("grid", "order", "every"),
    ),
    _numbered("named-views", "a folder of images named by row and column, such as view_00_03.png", "grid", "order"),
    _numbered("row-folders", "a folder of folders, one for each row of cameras, with numbered images", "grid", "order"),
    Format(
        name="hci-hdf5",
        description="old HCI light fields: an HDF5 file with LF and GT_DEPTH",
        recognise=hci_old.recognise_hdf5,
        read=hci_old.read_hci_hdf5,
        extra="hdf5",
        takes=("unit",),
    ),
    _numbered(
        "camera-row",
        "a folder of numbered images, such as view_0034.jpg: a row of cameras, also at several times",
        "grid",
        "every",
        "order",
    ),
    Format(
        name="lytro",
        description="a processed Lytro container (.lfp): the views in it, as Lytro's program computed them",
        recognise=lytro.recognise,
        read=lytro.read_lytro,
        extra="video",
        inside=lytro.inside,
    ),
    Format(
        name="lenslet",
        description="a raw capture of a lenslet camera: .lfp, .lfr or .raw of Lytro, or a grey picture of its sensor",
        recognise=lenslet.recognise,
        read=lenslet.read_lenslet,
        inside=lenslet.inside,
    ),
)


def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users look for
    allow_missing: bool = False,
    grid: tuple[int, int] | None = None,
    order: str | None = None,
    every: int | None = None,
    pattern: str | None = None,
    frame: int | None = None,
    axes: str | None = None,
    unit: str | None = None,
    transpose: bool = False,
    flip: str = "",
    lazy: bool = False,
    needed: Needed | None = None,
) -> LightField:
    """Read a light field from files.

    Parameters
    ----------
    path
        What to read: a folder of views, or a file that holds all of them.
    format
        Name of an entry of `FORMATS`; None finds it out from the path.
    allow_missing
        Whether a grid may have lost some of its views. Default False: a grid with more than half of its views, but not
        all of them, is an error. Patterns that leave places empty on purpose (a cross, a star, a row, a column) and
        grids with fewer views are always read.
    grid
        (rows, columns) of the views, for formats whose files do not say it: those with "grid" in `Format.takes`.
        Default None: found from the files; where that is impossible, an error asks for it.
    order
        How views that are stored one after the other fill their grid: "row-major" (row by row), "column-major",
        "serpentine" (every second row backwards) or "serpentine-columns"; for formats with "order" in `Format.takes`.
        Default None: row-major.
    every
        Every how many images or frames one is a view, >= 1, beginning with the first; for formats with "every" in
        `Format.takes`. Default None: all are views.
    pattern
        What the numbers in the names of images count: "cam{u}_frame{t}.png", with {u} for columns, {v} for rows, {n}
        for cameras that are numbered one after the other, {t}, {date} and {time}, and {exposure}. "*" stands for
        anything, "/" for a folder. Default None: found from the words beside them.
    frame
        Index of the time, from 0, of folders that hold several times for each camera. Default None: the first.
    axes
        The order of the axes of an array, one letter each: v and u (rows and columns of views) or n (views one after
        the other), y, x and c (colours): "yxvuc". For formats with "axes" in `Format.takes`. Default None: as the
        format has it.
    unit
        Unit of the lengths in files that do not say it, "mm", "cm" or "m"; for formats with "unit" in `Format.takes`.
        Default None: metres.
    transpose
        Whether the files count rows of cameras for columns; before `flip`. Default False.
    flip
        Axes along which the files count the cameras the other way round: "u" (columns from the right), "v" (rows from
        below) or "uv". Default "": neither. With a wrong direction near things come out far.
    lazy
        Whether views stay on disk. Then `views` is mapped from a file, and only what is looked at takes memory. Folders
        of images are unpacked into a temporary file (in `TMPDIR`), .npy files are mapped as they are, and other formats
        are read into memory. Default False.
    needed
        Function of the offsets [n, 2] of all views from the reference, as `LightField.offsets`, that returns the
        indices of those that are needed, in order and with the reference. Where images are the views of a grid, or an
        .npy file holds them, others are not read, and the light field lacks them. All are read if those that are needed
        have masks, use fewer bits than their type or contradict the places of their cameras, and with `order`,
        `transpose` or `flip`. Default None: all.

    Returns
    -------
    The light field. Views are uint8, uint16 or float32 as in the files; `reading` says what was taken for what and why,
    `notes` what was noticed. Where all four corners of all views are black, as a lens array leaves them, `valid` leaves
    these out. Where uint16 views use fewer bits, `white` is the largest value of these.

    Raises
    ------
    LightFieldError
        If the path is missing or not a known format, it cannot be known what its files mean, an option is wrong or
        means nothing for the format, a library that it needs is missing, or its files are damaged or contradict each
        other.

    Examples
    --------
    >>> notes = lfgpu.io.write_hci(lf, "boxes")
    >>> lfgpu.read("boxes").grid_shape
    (5, 5)
    """
    path = named(path)
    check_flip(flip)
    check_grid_option(grid, order)
    check_unit(unit)
    if axes is not None:
        check_axes(axes)
    for name, count, least in (("every", every, 1), ("frame", frame, 0)):
        if count is not None:
            check_whole(name, count, least)
    for name, flag in (("allow_missing", allow_missing), ("transpose", transpose), ("lazy", lazy)):
        if not isinstance(flag, bool):
            raise LightFieldError(f"{name} must be True or False, not {flag!r:.60}.")
    for name, text in (("format", format), ("pattern", pattern)):
        if text is not None and not isinstance(text, str):
            raise LightFieldError(f"{name} must be a text, not {text!r:.60}.")
    chosen = chosen_format(path, format, pattern)[0]
    check_exists(path)
    given: dict[str, Any] = {
        "grid": grid,
        "order": order,
        "every": every,
        "pattern": pattern,
        "frame": frame,
        "axes": axes,
    }
    options: dict[str, Any] = {name: value for name, value in {**given, "unit": unit}.items() if value is not None}
    for name in options:
        if name not in chosen.takes:
            raise LightFieldError(f"{path} is read as {chosen.name}, for which {name} means nothing; leave it out.")
    for name in ("order", "unit"):
        options.pop(name, None)
    if allow_missing and _MISSING in chosen.takes:
        options[_MISSING] = True
    order = order or ORDERS[0]
    with on_disk(lazy), in_part(None if transpose or flip or order != ORDERS[0] else needed) as part:
        found = chosen.read(path, **options)
        found = reordered(found, order)
        found = flipped(transposed(found) if transpose else found, flip)
        found = in_unit(found, unit) if "unit" in chosen.takes else found
        found = without_black_corners(with_white(found))
        found = told(found, chosen.name, order=order, transpose=transpose, flip=flip)
        doubts = contradictions(found)
    if part.left_out and (doubts or found.valid is not None or found.white is not None):
        return read(path, format=format, allow_missing=allow_missing, lazy=lazy, **given, unit=unit)  # all views tell
    forget(found.views)
    return replace(found, notes=(*found.notes, *doubts))


def check_grid_option(grid: object, order: object) -> None:
    """Raise LightFieldError unless these are a pair of whole numbers and one of `ORDERS`, or None."""
    if grid is not None and not (
        isinstance(grid, tuple | list) and len(grid) == 2 and all(isinstance(n, Integral) and int(n) > 0 for n in grid)
    ):
        raise LightFieldError(f"grid must be (rows, columns), whole numbers from 1 on, not {grid!r}.")
    if order is not None and order not in ORDERS:
        raise LightFieldError(f"order must be one of {', '.join(ORDERS)}, not {order!r}.")


def chosen_format(path: Path, name: str | None, pattern: str | None = None) -> tuple[Format, str]:
    """Return the format that a path is read as, and why; with a pattern of names it is a folder of numbered images."""
    if name is not None:
        return _named(name), "as told"
    if pattern is not None:
        return _named("camera-row"), f"because the pattern {pattern} names its images"
    found, reason = recognise(path)
    return found, f"because {reason}"


def recognise(path: str | os.PathLike[str]) -> tuple[Format, str]:
    """Return the format of a path and why it is taken for that; LightFieldError if it is none that is known."""
    path = named(path)
    check_exists(path)
    for candidate in FORMATS:
        reason = candidate.recognise(path)
        if reason is not None:
            if (held := several_in(path, candidate)) is not None:
                raise LightFieldError(held)
            return candidate, reason
    files = [entry for entry in entries(path) if entry.is_file()] if path.is_dir() else []
    if captures := [file for file in files if lenslet.recognise(file) or lytro.recognise(file)]:
        raise LightFieldError(_each_its_own(path, captures, "captures"))
    raise LightFieldError(
        f"{path} is not a light field of a known format: it is {_what(path)}. "
        f"Known are {', '.join(entry.name for entry in FORMATS)}."
    )


def several_in(folder: Path, chosen: Format) -> str | None:
    """Describe a folder that holds light fields of their own and is taken for one of a format; else None."""
    if not chosen.looks_below:
        return None
    if images := image_files(folder):
        if chosen.name in ANY_IMAGES and all(lenslet.recognise(image) for image in {images[0], images[-1]}):
            return _each_its_own(folder, images, "raw captures")
        if len(images) > 1:
            return None
    kinds = {inside: its for inside in sub_folders(folder) if (its := kind(inside)) is not None}
    if set(kinds.values()) <= set(ANY_IMAGES):
        return None
    if len(kinds) > 1:
        return _each_its_own(folder, list(kinds), "light fields")
    path, name = kinds.popitem()
    return f"{folder} holds one light field: give {path}, which is {name}." if chosen.name in ANY_IMAGES else None


def _each_its_own(folder: Path, them: list[Path], what: str) -> str:
    return (
        f"{folder} holds {len(them)} {what}, each a light field of its own ({listed(them)}): give one of them, or the "
        "folder to lfgpu batch."
    )


def inside(path: str | os.PathLike[str], *, format: str) -> Inside:  # noqa: A002 - as for `read`
    """Describe what a path of a format holds beside views, or instead of them; LightFieldError if it is damaged."""
    path, chosen = named(path), _named(format)
    check_exists(path)
    return Inside(()) if chosen.inside is None else chosen.inside(path)


def kind(path: Path) -> str | None:
    """Return the name of the format of a path; None if it is no light field, or several."""
    try:
        return recognise(path)[0].name
    except LightFieldError:
        return None


def _named(name: str) -> Format:
    for candidate in FORMATS:
        if candidate.name == name:
            return candidate
    raise LightFieldError(f"unknown format {name!r}; known are {', '.join(entry.name for entry in FORMATS)}.")


def check_exists(path: Path, what: str = "a folder of views or a light field file") -> None:
    """Raise LightFieldError if there is nothing at a path, or it may not be looked at."""
    try:
        path.stat()
    except FileNotFoundError:
        raise LightFieldError(f"{path} does not exist; give {what}.") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise LightFieldError(f"{path} cannot be opened: {getattr(error, 'strerror', None) or error}.") from error
    not_waited_for(path, what)
    check_fetched(path)


_ARCHIVES = {b"PK\x03\x04": "zip", b"PK\x05\x06": "zip", b"7z\xbc\xaf": "7z", b"Rar!": "rar", b"\x1f\x8b": "gzip"}

_NAMED_SO = frozenset({".h5", ".hdf5", ".mat", ".npy", ".npz", ".mp4", ".mov", ".mkv", ".webm", ".avi"})


def _contents(path: Path, found: list[Path]) -> str:
    if not found:
        return "an empty folder"
    said = f"a folder with {listed(found)}"
    if sum(entry.suffix.lower() == ".npy" for entry in found) > 1 and not image_files(path):
        return (
            f"{said}: if each is one view, stack them as one file, such as numpy.save('views.npy', numpy.stack(views)) "
            "of [n, y, x, c]; if each is a light field, give one"
        )
    if any(entry.is_dir() or entry.suffix.lower() in _NAMED_SO for entry in found):
        return said
    if not image_files(path):
        return f"{said}, none of which is a picture that can be read: convert them, to PNG for example"
    return (
        f"{said}, whose names do not say where the cameras stood: number them, such as view_00_03.png (row, column) or "
        "view_0012.png (a row of cameras)"
    )


def _what(path: Path) -> str:
    """Describe a path that no format recognises, and say what to do about it."""
    if path.is_dir():
        return _contents(path, entries(path))
    start = head(path, 4)
    if not start:
        return "an empty file (give the folder that holds the views)"
    for magic, kind in _ARCHIVES.items():
        if start.startswith(magic):
            return f"a {kind} archive (unpack it and give the folder)"
    if path.suffix.lower() in _NAMED_SO:
        return f"a file named {path.suffix} that does not begin as such files do (it is damaged or another kind)"
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        return "a file (give the folder that holds the views)"
    for candidate in FORMATS:
        if candidate.extra is None and candidate.recognise(path.resolve().parent):
            return f"one image (give the folder {path.resolve().parent}, which is {candidate.name})"
    return (
        "one image (give the folder that holds the views; --format mosaic if its pixels are blocks of views behind "
        "microlenses, --format tiles if it shows views side by side)"
    )

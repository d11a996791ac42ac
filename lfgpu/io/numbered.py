"""Folders of pictures whose names have numbers: rows and columns, cameras, or cameras and times."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import parallax
from lfgpu.io.arrays import grid_shape
from lfgpu.io.folders import entries, image_files, listed, sub_folders
from lfgpu.io.grid import by_place, read_grid
from lfgpu.io.naming import (
    BESIDE,
    CAMERA,
    COLUMN,
    ROW,
    SIDE,
    TIME,
    WORD,
    Name,
    Naming,
    Number,
    families,
    matching,
    understood,
    values,
    word,
)
from lfgpu.io.questions import LOOKED_AT, beside, joined, question, rivals

_MOST = 10_000  # places of a row
_OTHERS = 0.5  # of the pictures named alike: so many named otherwise may as well be the views

_CALIBRATIONS = ("transforms.json", "transforms_train.json", "models.json", "poses_bounds.npy", "calib.json")
"""Names of calibrations that are put beside pictures."""


@dataclass(frozen=True)
class _Found:
    """The pictures of a folder that are named alike, and which others there are."""

    folder: Path
    naming: Naming
    left_out: tuple[Path, ...]
    rival: Path | None  # one of the pictures that may as well be the views
    alike: bool = False  # true if these have the same numbers: words may name cameras, and numbers times


def recognise(path: Path, *, kind: str) -> str | None:
    """Say why a path is a folder of a kind ("named-views", "row-folders" or "camera-row"); None if it is not."""
    if not path.is_dir() or (found := _found(path)) is None or _kind(found.naming) != kind:
        return None
    return found.naming.sentence(path)


def _kind(naming: Naming) -> str:
    if not _names_places(naming) or not _is_one_scene(naming):
        return "camera-row"
    return "row-folders" if _in_folders(naming, ROW, COLUMN) else "named-views"


def _in_folders(naming: Naming, *meanings: str) -> bool:
    """Tell whether folders are counted by a number of one of these meanings."""
    texts = naming.names[0].texts
    return any("/" in "".join(texts[k + 1 :]) and n.meaning in meanings for k, n in enumerate(naming.numbers))


def _is_one_scene(naming: Naming) -> bool:
    """Tell whether folders that no word calls rows show one scene: other folders are often numbered, too."""
    rows = naming.of(ROW)
    told = all("word" in number.why or "pattern" in number.why for number in rows)
    if told or not _in_folders(naming, ROW) or not rows[0].varies:
        return True
    lines = [[f for f, row in zip(naming.files, rows[0].values, strict=True) if row == n] for n in set(rows[0].values)]
    return parallax.one_scene([line[len(line) // 2] for line in lines])


def read_numbered(
    path: Path,
    *,
    kind: str | None = None,
    allow_missing: bool = False,
    grid: tuple[int, int] | None = None,
    every: int | None = None,
    pattern: str | None = None,
    frame: int | None = None,
) -> LightField:
    """Read pictures whose names say by their numbers where the cameras stood.

    Words beside the numbers are believed: row, r, y, v and column, col, c, x, u; camera, cam, view; frame, time, t.
    Without words the last two numbers beside each other are row and column, and a single number counts cameras. Dates
    and times of day are no places. What stays open is asked: a LightFieldError says which option settles it.

    Names of sub-folders count like the beginnings of file names. `kind` is that of `recognise` where there are several;
    `grid` holds cameras with one number, row by row; `every` takes one camera of so many; `pattern` says what numbers
    are: "cam{u}_frame{t}.png"; `frame` is a time, from 0.
    """
    found = _found(path, pattern, kind)
    if found is None:
        raise LightFieldError(
            f"{path} has no pictures with numbers in their names, such as view_00_03.png or view_0012.png; give the "
            "folder that holds them."
        )
    if found.rival is not None:
        raise LightFieldError(rivals(path, found.naming, found.rival, alike=found.alike))
    if (asked := question(path, found.naming)) is not None:
        raise LightFieldError(asked)
    notes = []
    folders = {file.parent for file in found.naming.files}
    if path not in folders and len(folders) == 1:
        notes.append(f"The views are in the folder {folders.pop().name}.")
    if found.left_out:
        notes.append(
            f"Left out {len(found.left_out)} of the images, not named as the others: {listed(found.left_out)}."
        )
    naming, chosen = _at_one_time(path, found.naming, frame, allow_missing=allow_missing)
    notes += chosen
    rows, columns, cameras = (naming.of(meaning) for meaning in (ROW, COLUMN, CAMERA))
    number, down = None if cameras else _alone(naming), bool(rows) and not cameras and not columns
    if number is not None and grid is None and not _is_in_no_line(naming, number):
        number = None
    if number is None and not cameras and rows and columns:
        if grid is not None:
            raise LightFieldError(f"{path} has rows and columns in the names of its images; leave grid out.")
        return _read_grid(path, naming, rows[0], columns[0], notes, allow_missing=allow_missing)
    number = number or next(iter(cameras or columns or rows or naming.of(TIME)), None)
    if number is None:
        raise LightFieldError(
            f"{path} has one view only ({naming.files[0].name}); depth needs at least two views of the scene."
        )
    return _read_row(path, naming, number, notes, grid=grid, every=every, down=down, allow_missing=allow_missing)


def _alone(naming: Naming) -> Number | None:
    """Return the number that differs of two beside each other, neither of which has a word: "view_00_03"."""
    pair = [number for number in (*naming.of(ROW), *naming.of(COLUMN)) if number.why == BESIDE]
    varying = [number for number in pair if number.varies]
    return varying[0] if len(pair) == 2 and len(varying) == 1 else None


def _is_in_no_line(naming: Naming, alone: Number) -> bool:
    """Tell whether pictures show that their cameras do not stand in a line as the number that differs says."""
    files = [file for _, file in sorted(zip(alone.values, naming.files, strict=True))]
    return len(files) > 3 and parallax.line(parallax.consecutive(files[:LOOKED_AT])) not in (None, alone.meaning)


def frames_of(path: Path, pattern: str | None = None) -> int:
    """Count the times that a folder holds for each of its cameras; 1 if it is no such folder."""
    found = _found(path, pattern)
    if found is None or found.rival is not None or question(path, found.naming) is not None:
        return 1
    return len(_times(found.naming))


def holds_cameras(path: Path) -> bool:
    """Tell whether folders in a folder are cameras: then none is a light field itself.

    The words in their names say so, "left" as well, or times in them that do not look like views. Where there are no
    words, pictures say so: those of one folder do not stand in a line or a grid, those of one number in all folders do.
    """
    if (found := _found(path)) is None:
        return False
    if found.rival is not None:
        sides = {SIDE.sub("", str(file.relative_to(path)), count=1) for file in (found.naming.files[0], found.rival)}
        return found.alike and len(sides) == 1
    texts = found.naming.names[0].texts
    places = [(k, n) for k, n in enumerate(found.naming.numbers) if n.varies and n.meaning in (ROW, COLUMN, CAMERA)]
    if places and all("word" in n.why and "/" in "".join(texts[k + 1 :]) for k, n in places):
        return True
    varying = [(k, n) for k, n in enumerate(found.naming.numbers) if n.varies]
    if len(varying) != 2 or "/" not in "".join(texts[varying[0][0] + 1 : varying[1][0] + 1]):
        return False
    (at, outer), (_, inner) = varying
    if SIDE.fullmatch(word(texts[at])):
        return True
    if outer.meaning == TIME or ("word" in inner.why and inner.meaning != TIME):
        return False
    files = dict(zip(zip(outer.values, inner.values, strict=True), found.naming.files, strict=True))
    one = [file for (folder, _), file in sorted(files.items()) if folder == outer.values[0]][:LOOKED_AT]
    told = parallax.consecutive(one)
    if parallax.line(told) or (told is not None and parallax.best_order(told, _grids(len(one))) is not None):
        return False
    across = [file for (_, number), file in sorted(files.items()) if number == inner.values[0]][:LOOKED_AT]
    return inner.meaning == TIME or (parallax.one_scene(across) and bool(parallax.line(parallax.consecutive(across))))


# --- which pictures ---


def _found(path: Path, pattern: str | None = None, kind: str | None = None) -> _Found | None:
    if not path.is_dir():
        return None
    own = image_files(path)
    if pattern is not None:
        depth = pattern.count("/")
        files = own if depth == 0 else _deeper(path)
        if depth == 0 and not files and len(sub_folders(path)) == 1:
            return _found(sub_folders(path)[0], pattern)
        naming = matching(files, path, pattern)
        return _Found(path, naming, tuple(file for file in files if file not in naming.files), None)
    kinds = families(own, path)
    if not kinds or not _may_be_views(kinds[0]):
        deeper = families(_deeper(path), path)
        if deeper and _may_be_views(deeper[0]):
            kinds, own = deeper, [name.file for kind in deeper for name in kind]
    if not kinds or not _may_be_views(kinds[0]):
        return None
    most = [k for k in kinds if len(k) == len(kinds[0])]
    chosen = next((k for k in most if _names_places(understood(k))), kinds[0])
    if kind is not None and _kind(understood(chosen)) != kind:  # somebody asked for it
        kinds = [k for k in kinds if _kind(understood(k)) == kind] or [chosen]
        chosen = kinds[0]
    mine, folders = {name.file for name in chosen}, {name.file.parent for name in chosen}
    many = [k for k in kinds if k is not chosen and len(k) > 1]
    rivals = [k for k in many if len(k) > _OTHERS * len(chosen) or k[0].file.parent not in folders]
    left_out = tuple(file for file in own if file not in mine)
    others = {name.file for k in kinds for name in k} - mine
    if not rivals and len(others) >= len(mine):
        return _Found(path, understood(chosen), left_out, min(others))
    if not rivals:
        return _Found(path, understood(chosen), left_out, None)
    alike = {name.numbers for name in rivals[0]} == {name.numbers for name in chosen}
    return _Found(path, understood(chosen), left_out, rivals[0][0].file, alike)


def _deeper(path: Path) -> list[Path]:
    """List the images in the folders of a folder; where one holds nothing but a folder, such as "images", in that."""
    files = []
    for folder in sub_folders(path):
        own = image_files(folder)
        files += own if own or len(inside := entries(folder)) != 1 or not inside[0].is_dir() else image_files(inside[0])
    return files


def _may_be_views(kind: Sequence[Name]) -> bool:
    naming = understood(kind)
    return any(number.varies for number in naming.numbers) or _names_places(naming)


def _names_places(naming: Naming) -> bool:
    return bool(naming.of(ROW) and naming.of(COLUMN))


# --- one time ---


def _times(naming: Naming) -> list[tuple[int, ...]]:
    """Return the times at which there are pictures, in order; one if the time follows from the place."""
    places, times = naming.places, naming.of(TIME)
    if not times or not places[0] or len(set(places)) == len(places):
        return [()]
    return sorted(set(values(times)))


def _at_one_time(path: Path, naming: Naming, frame: int | None, *, allow_missing: bool) -> tuple[Naming, list[str]]:
    times = _times(naming)
    if frame is not None and not 0 <= frame < len(times):
        raise LightFieldError(
            f"{path} has {len(times)} times for each camera; frame must be from 0 to {len(times) - 1}."
        )
    if len(times) == 1:
        return naming, []
    wanted, every = times[frame or 0], set(naming.places)
    kept = [k for k, time in enumerate(values(naming.of(TIME))) if time == wanted]
    numbers = tuple(replace(number, values=tuple(number.values[k] for k in kept)) for number in naming.numbers)
    naming = Naming(tuple(naming.names[k] for k in kept), numbers)
    places, cameras = set(naming.places), len(every)
    if len(places) < cameras and not allow_missing:
        raise LightFieldError(
            f"{path} has pictures of {len(places)} of its {cameras} cameras at time {frame or 0}, "
            f"{naming.files[0].name}; add the others, number alike the times that belong together, or pass "
            "allow_missing=True (--allow-missing on the command line)."
        )
    return naming, [
        f"There are {cameras} cameras and {len(times)} times; this is time {frame or 0} ({naming.files[0].name} "
        "...): take another with frame=1 (--frame 1 on the command line), or all with lfgpu batch or lfgpu live."
    ]


# --- rows and columns ---


def _read_grid(
    path: Path, naming: Naming, rows: Number, columns: Number, notes: list[str], *, allow_missing: bool
) -> LightField:
    """Views at the places that their names say.

    Both axes count from the same number, so that a lost first row is noticed, unless numbers have signs or a pattern
    names them. An axis along which the cameras do not stand (one row or one column of views) is left out of that. x and
    y are distances: if those of a full grid have a common step, that is the view step.
    """
    if not _is_one_scene(naming):
        names = sorted({file.parent.name for file in naming.files})
        raise LightFieldError(
            f"{path} has several folders with numbered images ({', '.join(names)}); give one. They do not show one "
            "scene, so they are no rows of one light field."
        )
    axes = (set(rows.values), set(columns.values))
    row, column = min(axes[0]), min(axes[1])
    full = len(naming.names) == len(axes[0]) * len(axes[1])
    step = _step(*axes) if full and {rows.why, columns.why} == {WORD.format(axis) for axis in "xy"} else 1
    own = min(row, column) < 0 or min(map(len, axes)) == 1 or step > 1 or (full and "pattern" in rows.why)
    if row != column and not own:
        if full and rows.why == BESIDE and not allow_missing:
            raise LightFieldError(beside(path, naming, row, column))
        row = column = min(row, column)
    shape = ((max(axes[0]) - row) // step + 1, (max(axes[1]) - column) // step + 1)
    if shape[0] * shape[1] > _MOST * _MOST or max(shape) > _MOST:
        raise LightFieldError(
            f"{path} has images numbered up to {max(max(a) for a in axes)}; that is no grid of cameras."
        )
    places = [((r - row) // step, (c - column) // step) for r, c in zip(rows.values, columns.values, strict=True)]
    zero = (-row // step, -column // step)
    light_field = read_grid(
        by_place(zip(places, naming.files, strict=True)),
        shape,
        folder=path,
        allow_missing=allow_missing,
        reference=zero if min(row, column) < 0 and zero in places else None,
        notes=notes,
    )
    why = f"{naming.sentence(path)}; rows count from {row}, columns from {column}"
    why += f", in steps of {step}" * (step > 1)
    return replace(light_field, reading=replace(light_field.reading, places=why))


def _step(*axes: set[int]) -> int:
    """Return the common step of distances along rows and columns; 1 if some of them are left out."""
    step = math.gcd(*(value - min(axis) for axis in axes for value in axis)) or 1
    return step if all(len(axis) == (max(axis) - min(axis)) // step + 1 for axis in axes) else 1


# --- cameras with one number ---


def _read_row(
    path: Path,
    naming: Naming,
    number: Number,
    notes: list[str],
    *,
    grid: tuple[int, int] | None,
    every: int | None,
    down: bool,
    allow_missing: bool,
) -> LightField:
    views = sorted(zip(number.values, naming.files, strict=True))
    if number.meaning == TIME or not any(n.varies for meaning in (ROW, COLUMN, CAMERA) for n in naming.of(meaning)):
        views = list(enumerate(file for _, file in sorted(zip(values(naming.of(TIME)), naming.files, strict=True))))
    first, last_number = views[0][0], views[-1][0]
    step = math.gcd(*(value - first for value, _ in views)) or 1
    if (last_number - first) // step >= _MOST:
        raise LightFieldError(f"{path} has images numbered from {first} to {last_number}; that is no row of cameras.")
    gaps = (last_number - first) // step + 1 > len(views)
    if gaps and number.meaning == CAMERA and (asked := joined(path, naming, number)) is not None:
        raise LightFieldError(asked)
    chosen = [((value - first) // step, file) for value, file in views]
    if every is not None:
        chosen = [(place // every, file) for place, file in chosen if place % every == 0]
    count = chosen[-1][0] + 1
    if len(chosen) < count and not allow_missing:
        present = {place for place, _ in chosen}
        lost = [first + step * place for place in range(count) if place not in present]
        raise LightFieldError(
            f"{path} lacks {len(lost)} of the {count} views that its numbers from {first} to {last_number} count "
            f"(number {', '.join(map(str, lost[:5]))}{', ...' if len(lost) > 5 else ''}); add them, or pass "
            "allow_missing=True (--allow-missing on the command line) to go without."
        )
    if calibration := next((path / name for name in _CALIBRATIONS if (path / name).is_file()), None):
        notes.append(
            f"{calibration.name} may say where the cameras stand: lfgpu rectify takes it (--calibration {calibration})."
        )
    why = naming.sentence(path)
    if grid is None:
        shape, because = _shape(path, [file for _, file in chosen], count, down=down)
        why += f"; {because}"
    else:
        if len(chosen) < count != math.prod(grid):
            raise LightFieldError(
                f"{path} has {len(chosen)} views, whose numbers from {first} to {last_number} count {count} places, "
                f"but a grid of {grid[0]} x {grid[1]} has {math.prod(grid)}: number the views of the grid row by row."
            )
        shape = grid_shape(path, count, grid)
        why += f"; the grid of {shape[0]} x {shape[1]} is as told, row by row"
    places = by_place((divmod(place, shape[1]), file) for place, file in chosen)
    light_field = read_grid(places, shape, folder=path, allow_missing=allow_missing, notes=notes)
    return replace(light_field, reading=replace(light_field.reading, places=why))


def _grids(count: int) -> list[tuple[int, int]]:
    """List the (rows, columns) of grids of so many views, at least two of each."""
    return [(rows, count // rows) for rows in range(2, count // 2 + 1) if count % rows == 0]


def _shape(path: Path, files: Sequence[Path], count: int, *, down: bool) -> tuple[tuple[int, int], str]:
    """(rows, columns) of numbered cameras, and why: one row, if no grid is possible or the pictures show it."""
    if down:
        return (count, 1), "there is one column of cameras, counted downwards"
    possible = _grids(count)
    if not possible or len(files) != count:
        return (1, count), "they are taken for one row, to the right in equal steps"
    looked_at = files[:LOOKED_AT]
    told = parallax.consecutive(looked_at)
    if parallax.line(told) == "row":
        return (1, count), "by their parallax they stand in one row; it is taken to run to the right in equal steps"
    proposed = possible[: len(possible) // 2 + 1] if len(possible) > 6 else possible
    options = ", ".join(f"--grid {rows}x{columns}" for rows, columns in [(1, count), *proposed])
    fit = parallax.best_order(told, [(1, count), (count, 1), *possible]) if told is not None else None
    shows = f"; by the pictures {fit} fits" if fit else ""
    shows += ", or with --flip u if near comes out far then" * ("--flip" in shows)
    raise LightFieldError(
        f"{path} has {count} numbered images, in one row or in a grid: say which with one of {options} "
        f"(grid=(rows, columns) in Python), and --order if they are not stored row by row{shows}."
    )

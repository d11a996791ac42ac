"""Light fields told in other words: each is read as what it is, or refused, or a note says what is wrong with it.

    python -m tests.io.meanings --examples 5000 --seed 1 [--processes 2]

Each example takes a small scene, whose views and cameras are known, and writes it in one of many ways that mean the
same: other names, folders, axes, orders, orientations, masks, kinds of values, many files or one. A quarter contradict
themselves (`LIES`). It is read as by somebody who answers what is asked and follows what is advised, and what was read
is compared with the scene: which view is whose picture, where its camera stands, which pixels are valid.
"""

import argparse
import multiprocessing
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from threadpoolctl import threadpool_limits

from lfgpu import scenes
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read
from tests.io.mutations import pick

Random = np.random.Generator
LIES = ("transposed", "flipped", "alternating", "upside down", "one picture", "turned")
"""Ways to contradict: words for the other axis, columns from the right, every second row from the right, some pictures
upside down, all pictures equal, all pictures turned by 90 degrees."""
WARNINGS = re.compile(
    "By their parallax|the same picture|upside down|does not look like|from the place of|no parallax|repeat in the pic"
)
"""Words of the notes on contradictions."""
_SIZE, _GRID, _SCENES = (72, 88), 5, 6
_SAME = 0.995  # correlation of a view with its picture, JPEG included


@dataclass(frozen=True)
class Scene:
    """Views of a grid of cameras, as they are seen."""

    views: NDArray[np.uint8]
    """[rows, columns, y, x, c]."""
    valid: NDArray[np.bool_] | None = None
    """[rows, columns, y, x]; None where all are."""
    lie: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        return self.views.shape[0], self.views.shape[1]

    def told(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Return the place of the view that is written as that of each (row, column)."""
        rows, columns = self.shape
        if self.lie == "transposed":
            return {(c, r): (r, c) for r, c in np.ndindex(rows, columns)}
        back = {"flipped": range(rows), "alternating": range(1, rows, 2)}.get(self.lie, range(0))
        return {(r, columns - 1 - c if r in back else c): (r, c) for r, c in np.ndindex(rows, columns)}

    def stored(self) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
        """Return views and masks in the order in which they are told."""
        told = self.told()
        shape = (max(r for r, _ in told) + 1, max(c for _, c in told) + 1)
        order = [told[place] for place in np.ndindex(shape)]
        views, valid = (
            None if a is None else np.stack([a[place] for place in order]).reshape(*shape, *a.shape[2:])
            for a in (self.views, self.valid)
        )
        assert views is not None
        if self.lie == "one picture":
            views = np.broadcast_to(views[:1, :1], views.shape)
        if self.lie == "turned":
            views = np.rot90(views, axes=(2, 3))
        if self.lie == "upside down":
            views = views.copy()
            views[-1, ::3] = views[-1, ::3, ::-1, ::-1]
        return views, valid


@dataclass
class Told:
    """Files, and the answers of somebody who knows what they mean."""

    path: Path
    way: str
    answers: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)


@cache
def _made(seed: int, row: bool) -> NDArray[np.uint8]:
    reach = (-1.5, 1.5) if seed % 2 else (0.3, 2.0)
    grid = (1, 9) if row else (_GRID, _GRID)
    lf = scenes.make(("planes", "boxes")[seed % 2], grid=grid, size=_SIZE, disparity_range=reach, seed=seed)
    return np.asarray(lf.views.reshape(*grid, *lf.views.shape[1:]))


def drawn(rng: Random) -> Scene:
    """Draw a scene: some of the cameras of one that was rendered, in colour or grey, whole or masked."""
    in_line = rng.random() < 0.25
    views = _made(int(rng.integers(_SCENES)), in_line)
    rows, columns = (int(rng.integers(2, side + 1)) if side > 1 else 1 for side in views.shape[:2])
    if rng.random() < 0.1:
        rows, columns = 1, 2
    top, left = (int(rng.integers(side - used + 1)) for side, used in zip(views.shape, (rows, columns), strict=False))
    views = views[top : top + rows, left : left + columns]
    if in_line and rng.random() < 0.3:  # a column of cameras is a row with everything transposed
        views = views.transpose(1, 0, 3, 2, 4)
    if rng.random() < 0.25:
        views = views[..., 1:2]
    scene = Scene(views)
    if rng.random() < 0.25:
        lies = LIES if min(scene.shape) > 1 else LIES[3:]
        scene = replace(scene, lie=pick(rng, lies))
    return scene


# --- folders of pictures ---

_BEFORE = (
    *("", "", "", "img", "IMG", "view", "lf_", "scene7", "run 02", "DSC", "cam", "camera ", "2024-02-29", "20240229"),
    *("v2", "f2.8", "iso100", "120mm", "take-3", "rgb", "left", "0", "x264", "R5", "c1", "row of 9", "Lytro40"),
    *("frame", "t0", "out", "out_7", "sensor1", "4K", "y", "u", "3x3", "v1.2.3", "S01E02", "X-T4", "100_"),
    *("1_1", "exp8"),
)
_AFTER = ("", "", "", "", "rgb", "8bit", "1920x1080", "v2", "final", "left", "12", "x2", "f4", "(1)", "r", "0", "px")
_BETWEEN = ("_", "_", "-", " ", ".", "__", "")
_WORDS = (("row", "col"), ("r", "c"), ("v", "u"), ("y", "x"), ("Row", "Column"), ("t", "s"), ("line", "column"))
_KINDS = ("png", "png", "PNG", "tif", "tiff", "bmp", "jpg", "webp", "ppm")


def _count(rng: Random, word: str, step: int = 1) -> Callable[[int], str]:
    """Draw how a number is written."""
    first, digits = pick(rng, (0, 0, 0, 1, 1, 3)), pick(rng, (1, 2, 2, 3, 4) if word else (1, 2, 2, 3))
    glue = pick(rng, ("", "", "_", "-", " ")) if word else ""
    return lambda n: f"{word}{glue}{n * step + first:0{digits}d}"


def _joined(rng: Random, parts: Sequence[str], between: Sequence[str]) -> str:
    text = parts[0]
    for part, glue in zip(parts[1:], between, strict=True):
        bare = text[-1:].isdigit() and part[:1].isdigit()
        text += (glue or "_" if bare else glue) + part if text and part else part
    return text


def _pictures(scene: Scene, place: Path, rng: Random) -> Told:
    """Write a picture for each view, named by words or numbers, perhaps at several times, in one folder or several."""
    views, valid = scene.stored()
    rows, columns = views.shape[:2]
    scheme = pick(rng, ("words", "words", "words", "numbers", "numbers", "one word", "camera", "camera", "index"))
    words = pick(rng, _WORDS)
    swap = scheme == "words" and rng.random() < 0.5
    answers: dict[str, Any] = {}
    if scheme in ("camera", "index"):
        order = pick(rng, ("row-major", "row-major", "column-major", "serpentine"))
        places = np.arange(rows * columns).reshape(rows, columns)
        if order == "column-major":
            places = np.arange(rows * columns).reshape(columns, rows).T
        if order == "serpentine":
            places[1::2] = places[1::2, ::-1].copy()
        answers = {"grid": (rows, columns), "order": order}
        word = pick(rng, ("cam", "camera", "view", "Sensor", "Cam")) if scheme == "camera" else ""
        count = _count(rng, word)
        fields, named = [lambda r, c: count(int(places[r, c]))], ["{n}"]
    else:
        both = ["", ""] if scheme == "numbers" else list(words)
        if scheme == "one word":
            both = [pick(rng, ("row", "Row", "y", "line")), ""]
        step = pick(rng, (1, 1, 10, 25)) if set(both) == {"x", "y"} else 1  # distances
        row, column = (_count(rng, word, step) for word in both)
        fields, named = [lambda r, c: row(r), lambda r, c: column(c)], ["{v}", "{u}"]
    if swap:
        fields, named = fields[::-1], named[::-1]
    if rows == 1 and columns < 4 and rng.random() < 0.5:
        sides = pick(rng, (("left", "center", "right"), ("L", "M", "R"), ("Left", "Middle", "Right")))[:: 4 - columns]
        scheme, fields, named = "sides", [lambda r, c: sides[c]], ["{u}"]
    times = pick(rng, (1, 1, 1, 2, 3)) if scheme != "sides" else 1
    time_at = pick(rng, ("first", "last", "folder"))
    time_word = pick(rng, ("frame", "t", "time", "", "Frame", "shot", "take")) if times > 1 else ""
    time_digits = pick(rng, (1, 2, 4, 6))
    before, after = pick(rng, _BEFORE), pick(rng, _AFTER)
    if scheme not in ("words", "camera") and before.rstrip("0") in ("frame", "t", "y", "u"):
        before = ""  # a word that the number behind it would count
    between = [pick(rng, _BETWEEN) for _ in range(8)]
    folders = len(fields) == 2 and rng.random() < 0.25
    kind, alpha = pick(rng, _KINDS), valid is not None
    kind = "png" if alpha else kind
    orientation = int(rng.integers(1, 9)) if kind.lower() in ("png", "jpg", "webp", "tif") and rng.random() < 0.3 else 1
    wide = kind in ("png", "tif") and orientation == 1 and views.shape[4] == 1 and not alpha and rng.random() < 0.5
    static = rng.random() < 0.3

    def name(r: int, c: int, t: int, *, pattern: bool = False) -> str:
        own = [write(r, c) for write in fields]
        if pattern:
            own = [re.sub(r"\d+|^[A-Za-z]+$", mark, text) for text, mark in zip(own, named, strict=True)]
        time = "" if times == 1 else f"{time_word}{'{t}' if pattern else f'{t:0{time_digits}d}'}"
        parts = [before, *own, after]
        if time_at == "first" and time:
            parts.insert(1, time)
        if time_at == "last" and time:
            parts.insert(-1, time)
        text = _joined(rng, parts, between[: len(parts) - 1]) if not folders else ""
        if folders:
            text = f"{own[0]}/{_joined(rng, [p for p in parts if p is not own[0]], between[: len(parts) - 2])}"
        return f"{f'{time}/' if time_at == 'folder' and time else ''}{text.strip() or 'a'}.{kind}"

    for r, c in np.ndindex(rows, columns):
        for t in range(times):
            picture = views[r, c]
            if t:
                picture = picture // 2 + 60 if static else _later(picture, t)
            if valid is not None:
                picture = np.concatenate([picture, 255 * valid[r, c][..., None].astype(np.uint8)], axis=-1)
            _save(place / name(r, c, t), picture, orientation, wide=wide)
    answers["pattern"] = name(0, 0, 0, pattern=True)
    if times > 1:
        answers["frame"] = 0
    told = f"{scheme}{' times' * (times > 1)}{' folders' * folders}: {name(rows - 1, columns - 1, times - 1)}"
    return Told(place, told, answers)


def _later(picture: NDArray[np.uint8], time: int) -> NDArray[np.uint8]:
    """Return a picture in the middle of which something has moved."""
    later, (height, width) = picture.copy(), picture.shape[:2]
    part = np.s_[height // 4 : height // 2, width // 4 : 3 * width // 4]
    later[part] = np.roll(picture[part], 4 * time, axis=0)
    return later


def _save(path: Path, picture: NDArray[np.uint8], orientation: int = 1, *, wide: bool = False) -> None:
    """Write a picture such that the EXIF orientation brings it upright."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = picture if orientation < 5 else picture.swapaxes(0, 1)
    rows, columns = (-1 if orientation in turned else 1 for turned in ((3, 4, 6, 7), (2, 3, 7, 8)))
    stored = np.ascontiguousarray(stored[::rows, ::columns])
    image = Image.fromarray(stored[..., 0] if stored.shape[2] == 1 else stored)
    if wide:
        image = Image.fromarray(stored[..., 0].astype(np.uint16) * 257)
    options: dict[str, Any] = {}
    if orientation != 1:
        options["exif"] = Image.Exif()
        options["exif"][0x112] = orientation
    if path.suffix.lower() == ".jpg":
        options |= {"quality": 97, "subsampling": 0}
    if path.suffix.lower() == ".webp":
        options["lossless"] = True
    image.save(path, **options)


# --- one file ---


def _array(scene: Scene, place: Path, rng: Random) -> Told:
    """Write an array with its axes in some order, as NumPy, MATLAB and TIFF have them."""
    views, valid = scene.stored()
    rows, columns = views.shape[:2]
    if valid is not None:
        views = np.concatenate([views, 255 * valid[..., None].astype(np.uint8)], axis=-1)
    axes, one = "vuyxc", views
    if views.shape[4] == 1 and rng.random() < 0.7:
        axes, one = "vuyx", views[..., 0]
    if rng.random() < 0.4:
        axes, one = axes.replace("vu", "n"), one.reshape(rows * columns, *one.shape[2:])
    order = axes if scene.lie == "turned" or rng.random() < 0.3 else "".join(rng.permutation(list(axes)))
    kind = pick(rng, ("npy", "npz", "mat", "tif", "imagej", "ome"))
    if kind in ("imagej", "ome"):  # pictures come last there
        order = re.sub("[yx]", "", order) + "yx"
    stored: NDArray[Any] = np.ascontiguousarray(one.transpose([axes.index(axis) for axis in order]))
    answers = {"axes": order, "grid": (rows, columns)}
    if kind == "npy" and rng.random() < 0.5:
        stored = pick(
            rng, (stored.astype(np.float32) / 255, stored.astype(np.uint16) * 257, stored.astype("<f8") / 255)
        )
    path = place / f"views.{kind if kind[0] in 'nm' else 'tif'}"
    if kind == "npy":
        np.save(path, stored)
    elif kind == "npz":
        np.savez(path, views=stored)
    elif kind == "mat":
        from scipy.io import savemat

        savemat(path, {"LF": stored}, do_compression=True)
    else:
        import tifffile

        extra: dict[str, Any] = {} if kind == "tif" else {kind: True}
        letters = {"v": "T", "u": "Z", "n": "Z", "y": "Y", "x": "X", "c": "C"}
        if kind != "tif":
            extra["metadata"] = {"axes": "".join(letters[axis] for axis in order)}
        try:
            tifffile.imwrite(path, stored, photometric="minisblack", **extra)
        except ValueError:  # ImageJ has one order only
            tifffile.imwrite(path, stored, photometric="minisblack")
            kind = "tif"
    return Told(path, f"{kind} {order} {stored.shape}", answers)


def _one_picture(scene: Scene, place: Path, rng: Random, *, tiles: bool) -> Told:
    """Write one picture of views side by side, or of blocks of a pixel of each; perhaps it is taken for the other."""
    views, _ = scene.stored()
    rows, columns, height, width, colours = views.shape
    order = (0, 2, 1, 3, 4) if tiles else (2, 0, 3, 1, 4)
    sheet = views.transpose(order).reshape(rows * height, columns * width, colours)
    told = "tiles" if tiles else "mosaic"
    taken = pick(rng, ("tiles", "mosaic")) if rng.random() < 0.3 else told
    path = place / pick(rng, (f"a_{'tiles' if taken == 'tiles' else 'eslf'}.png", "a.png"))
    _save(path, sheet)
    options: dict[str, Any] = {"format": taken} if path.stem == "a" else {}
    if taken == told and rng.random() < 0.5:
        options["grid"] = (rows, columns)
    answers = {"grid": (rows, columns)} if taken == told else {"format": told}
    return Told(path, f"{told} as {taken} {rows}x{columns}", answers, options)


def _pages(scene: Scene, place: Path, rng: Random) -> Told:
    """Write a TIFF with a page for each view, at once or one by one."""
    import tifffile

    views, _ = scene.stored()
    rows, columns = views.shape[:2]
    flat = views.reshape(rows * columns, *views.shape[2:])
    kind = "rgb" if flat.shape[3] == 3 else "minisblack"
    flat = flat if kind == "rgb" else flat[..., 0]
    path = place / "pages.tif"
    at_once = rng.random() < 0.5
    answers: dict[str, Any] = {"grid": (rows, columns)}
    if kind == "rgb" and rng.random() < 0.3:  # a page for each colour
        kind, answers["axes"] = "minisblack", pick(rng, ("ncyx", "cnyx"))
        flat = flat.transpose(["nyxc".index(axis) for axis in answers["axes"]]).reshape(-1, *flat.shape[1:3])
    if at_once:
        tifffile.imwrite(path, flat, photometric=kind, metadata=pick(rng, (None, {})))
    for page in () if at_once else flat:
        tifffile.imwrite(path, page, photometric=kind, append=True)
    return Told(path, f"pages {answers}{' at once' * at_once}", answers)


WAYS: tuple[Callable[[Scene, Path, Random], Told], ...] = (
    *(_pictures,) * 6,
    *(_array,) * 3,
    partial(_one_picture, tiles=True),
    partial(_one_picture, tiles=False),
    _pages,
)


# --- reading, and what came of it ---


def _answer(text: str, told: Told, options: dict[str, Any]) -> dict[str, Any] | None:
    """Return options with those that a sentence advises, or asks somebody who knows for; None if it names none."""
    found = dict(options)
    if advised := re.search(r"((?:--(?:grid|order|flip) \S+ ?)+)fits", text):
        for name, value in re.findall(r"--(\w+) (\S+)", advised[1]):
            found[name] = tuple(map(int, value.split("x"))) if name == "grid" else value
    else:
        found |= {name: value for name, value in told.answers.items() if f"--{name}" in text}
        if "grid" in found and "grid" not in options and told.answers.get("order", "row-major") != "row-major":
            found["order"] = told.answers["order"]
        if "--allow-missing" in text and found == options:
            found["allow_missing"] = True
    return None if found == options else found


def _judged(lf: LightField, scene: Scene, *, masked: bool) -> str:
    """Compare what was read with the scene: "same", "reversed" (all cameras counted from the other end), or a reason.

    Views and cameras may be turned together, or mirrored: the map is, too. `masked` says that the format marks dark
    pixels, which are not compared.
    """
    for turned, mirrored in ((scene.lie == "turned", False), (False, True)):
        found = _compared(lf, scene, turned=turned, mirrored=mirrored, masked=masked)
        if found == "same":
            return found
    return _compared(lf, scene, turned=scene.lie == "turned", mirrored=False, masked=masked)


def _view_steps(lf: LightField, places: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return offsets in view steps where a pattern told numbers that are distances, which have another unit."""
    longest = max(float(np.abs(lf.offsets).max()), 1.0)
    factor = np.abs(places).max() / longest if "the pattern says so" in lf.reading.places else 1.0
    return lf.offsets * factor


def _compared(lf: LightField, scene: Scene, *, turned: bool, mirrored: bool, masked: bool) -> str:
    rows, columns = scene.shape
    views, places = scene.views, np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    if mirrored:
        views, places = views.swapaxes(2, 3), places[..., ::-1]
    if turned:
        views, places = np.rot90(views, axes=(2, 3)), np.stack([places[..., 1], -places[..., 0]], axis=-1)
    true, places = views.reshape(-1, *views.shape[2:]).mean(axis=3), places.reshape(-1, 2)
    if lf.size != true.shape[1:]:
        return f"views of {lf.size}"
    flat = true.reshape(len(true), -1)
    flat = (flat - flat.mean(1, keepdims=True)) / flat.std(1, keepdims=True)
    where = []
    for index, view in enumerate(lf.views):
        seen = view.mean(axis=2, dtype=np.float64).ravel()
        alike = flat @ ((seen - seen.mean()) / max(float(seen.std()), 1e-9)) / flat.shape[1]
        where.append(int(np.argmax(alike)))
        if alike[where[-1]] < _SAME:
            return f"view {index} is none of the pictures"
    if not masked:
        valid = scene.valid if scene.valid is None or not mirrored else scene.valid.swapaxes(2, 3)
        valid = None if valid is None else valid.reshape(true.shape)[where]
        if not np.array_equal(np.True_ if valid is None else valid, np.True_ if lf.valid is None else lf.valid):
            return "another mask"
    if len(set(where)) != len(true):
        return f"{len(set(where))} of {len(true)} views"
    offsets = places[where] - places[where[lf.reference_index]]
    seen = _view_steps(lf, offsets)
    if np.allclose(offsets, seen):
        return "same"
    return "reversed" if np.allclose(offsets, -seen) else f"cameras at {lf.offsets[:3].tolist()}"


def outcome(scene: Scene, told: Told) -> tuple[str, str]:
    """Read what was told; returns "same", "asked", "refused", "noted" or "wrong", and a reason."""
    options, said = dict(told.options), ""
    for _ in range(4):
        try:
            lf = read(told.path, **options)
            break
        except LightFieldError as error:
            said = str(error)
            further = _answer(said, told, options)
            if further is None:
                return "refused", said
            options = further
    else:
        return "refused", said
    masked = told.way.startswith(("mosaic", "mat"))
    found = _judged(lf, scene, masked=masked)
    warnings = [note for note in lf.notes if WARNINGS.search(note)]
    asked = "asked" if options != told.options else "same"
    if found == "same":
        return ("wrong", "a note contradicts it") if warnings else (asked, "")
    if not warnings and found == "reversed" and scene.lie in ("flipped", "turned"):
        return "reversed", f"{options}"
    if not warnings:
        return "wrong", f"{found} {options}"
    if match := re.search(r"read it with( --transpose)?(?: --flip (\w+))?", warnings[0]):
        again = read(told.path, **{**options, "transpose": bool(match[1]), "flip": match[2] or ""})
        if (after := _judged(again, scene, masked=masked)) not in ("same", "reversed"):
            return "wrong", f"advice that leads to {after}: {warnings[0]}"
    return "noted", warnings[0]


def one(seed: int, place: Path) -> tuple[str, str, str]:
    """Write and read the example of a seed; returns its outcome, how it was told, and a reason."""
    rng = np.random.default_rng(seed)
    scene = drawn(rng)
    way = pick(rng, WAYS)
    if way in (_pictures, _array) and not scene.lie and rng.random() < 0.2:  # parts of pictures are transparent
        scene = replace(scene, valid=np.asarray(rng.random(scene.views.shape[:4]) < 0.8))
    told = way(scene, place, rng)
    result, why = outcome(scene, told)
    return result, f"{scene.shape[0]}x{scene.shape[1]} {scene.lie or 'true'} {told.way}", why


def _some(seeds: range) -> list[tuple[int, tuple[str, str, str]]]:
    found = []
    for seed in seeds:
        with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
            found.append((seed, one(seed, Path(folder))))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--examples", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    counts: Counter[str] = Counter()
    seeds = range(arguments.seed, arguments.seed + arguments.examples)
    batches = [seeds[start : start + 50] for start in range(0, len(seeds), 50)]
    with multiprocessing.get_context("fork").Pool(arguments.processes) as pool:
        for batch in pool.imap(_some, batches):
            for seed, (result, way, why) in batch:
                counts[result] += 1
                if result == "wrong":
                    print(f"seed {seed}: {way}: {why}")
    print(", ".join(f"{count} {result}" for result, count in sorted(counts.items())))
    sys.exit(bool(counts["wrong"]))


if __name__ == "__main__":
    main()

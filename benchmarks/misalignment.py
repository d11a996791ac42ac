"""What cameras that are misaligned do to a map, and how much of it self-calibration undoes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.errors import BenchmarkError
from benchmarks.population import light_fields
from lfgpu import DepthResult, LightField, estimate_depth, evaluate, read, scenes
from lfgpu.calibration import Camera, Misalignment, consensus, disturb, refine
from lfgpu.calibration.misalign import displacements
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.calibration.resample import through
from lfgpu.errors import LightFieldError

Say = Callable[[str], None]
ARRAYS = ("9x9", "5x5", "star", "row", "irregular")
"""Which views of a light field are used: a middle part of its grid, lines of it, or 12 cameras in no grid."""

DISTURBANCES = ("shift=1", "gain=0.1", "roll=0.1", "scale=0.002", "shift=1,gain=0.1,roll=0.1,scale=0.002,offset=0.01")
"""As of `lfgpu scene --misalign`; "position=..." only on scenes of the package, which are rendered from there."""

_IRREGULAR = 12
_MARGIN = 0.1  # pixels per view step on either side of the true range


@dataclass(frozen=True)
class Scores:
    """Of a map: MSE x 100 and BadPix in percent.

    `level_03` is BadPix(0.03) less the median error: a shift of all views in proportion to their offsets is another
    plane of disparity 0, which no view tells.
    """

    mse_100: float
    badpix_07: float
    badpix_03: float
    badpix_01: float
    level_03: float


@dataclass(frozen=True)
class Row:
    """One disturbance of one array: scores with the cameras as they should be, as they are, and lined up.

    `off_px` and `left_px` are the shifts of the views, rms along each axis, before and after, against what the cameras
    are, without what views cannot tell; None where cameras stand beside their places.
    """

    scene: str
    array: str
    views: int
    crop: int
    disturbance: str
    seed: int
    preset: str
    right: Scores
    wrong: Scores
    refined: Scores
    off_px: float | None
    left_px: float | None
    status: str


@dataclass(frozen=True)
class Plan:
    """What is measured; `crop` is the longest side of the middle part of views that maps are made of, pixels."""

    scenes: tuple[str, ...]
    arrays: tuple[str, ...]
    disturbances: tuple[str, ...]
    seeds: int
    crop: int
    preset: str
    device: str | None


def run(plan: Plan, say: Say) -> Iterator[Row]:
    """Measure all disturbances of all arrays of all scenes, one after the other."""
    for array in plan.arrays:
        if array not in ARRAYS and not _grid(array):
            raise BenchmarkError(f"unknown array {array!r}; there are {', '.join(ARRAYS)} and other ROWSxCOLUMNS.")
    parsed = {how: Misalignment.parse(how) for how in plan.disturbances}
    for scene in plan.scenes:
        source = recording(scene)
        for array in plan.arrays:
            if (lf := _chosen(source(None), array)) is None:
                say(f"{scene} has no views for {array}")
                continue
            right = _scored(_cropped(lf, plan.crop), plan)
            for how, misalignment in parsed.items():
                for seed in range(plan.seeds):
                    say(f"{scene} {array} {how} seed {seed}")
                    yield _measured(scene, source, array, how, misalignment, seed, right, plan)


def _measured(
    scene: str,
    source: Callable[[NDArray[np.float64] | None], LightField],
    array: str,
    how: str,
    misalignment: Misalignment,
    seed: int,
    right: Scores,
    plan: Plan,
) -> Row:
    moved, whole = None, source(None)
    if misalignment.position:
        moved = displacements(len(whole.views), whole.reference_index, misalignment.position, seed)
        whole = source(moved)
    indices: list[int] = []
    chosen = _chosen(whole, array, indices)
    assert chosen is not None
    moved = None if moved is None else moved[indices]
    disturbed = disturb(chosen, misalignment, seed=seed, moved=moved)
    wrong = _cropped(disturbed.light_field, plan.crop)
    top, left, size = _window(chosen, plan.crop)
    cameras = [
        replace(camera, size=size, principal_point=(camera.principal_point[0] - left, camera.principal_point[1] - top))
        for camera in disturbed.cameras
    ]
    # The part of the shifts in proportion to the offsets moves all disparities alike, and stays.
    level = 0.0 if moved is not None and moved.any() else _level(wrong, cameras)
    bounds = _range(wrong, level)
    try:
        found = refine(
            wrong, positions=bool(misalignment.position), disparity_range=bounds, device=plan.device, model="similarity"
        )
        refined, status = found.light_field, found.status
        homographies = found.homographies if found.kept else None
    except LightFieldError as error:
        refined, status, homographies = wrong, str(error), None
    return Row(
        Path(scene).name,
        array,
        len(chosen.views),
        max(size),
        how,
        seed,
        plan.preset,
        right,
        _scored(wrong, plan, level),
        _scored(refined, plan, level),
        _left(wrong, cameras, None, moved),
        _left(wrong, cameras, homographies, moved),
        status,
    )


# --- steps ---


def recording(scene: str) -> Callable[[NDArray[np.float64] | None], LightField]:
    """A light field in a folder, or a scene of the package by name and seed, "boxes-11", rendered from displaced
    cameras if asked."""
    name, _, seed = scene.partition("-")
    if name in scenes.NAMES and not Path(scene).exists():
        if not (seed or "7").isdecimal():
            raise BenchmarkError(f"unknown scene {scene!r}; write NAME-SEED, as boxes-11.")
        number = int(seed or "7")
        return lambda moved: scenes.make(name, grid=(9, 9), size=(256, 256), seed=number, noise=0.004, displaced=moved)
    ((_, path),) = light_fields([Path(scene)]).items()
    lf = read(path)

    def recorded(moved: NDArray[np.float64] | None) -> LightField:
        if moved is not None:
            raise BenchmarkError(f"{scene} is recorded: its cameras cannot be moved; leave position out.")
        return lf

    return recorded


def _grid(array: str) -> tuple[int, int] | None:
    try:
        rows, columns = (int(part) for part in array.split("x"))
    except ValueError:
        return None
    return rows, columns


def _chosen(lf: LightField, array: str, indices: list[int] | None = None) -> LightField | None:
    """The views of an array, and their indices; None where the light field does not have them."""
    offsets = np.round(lf.offsets)
    size = _grid(array)
    if size is not None:
        reach = (size[1] - 1) // 2, (size[0] - 1) // 2
        chosen = np.flatnonzero((np.abs(offsets) <= reach).all(axis=1))
        if len(chosen) != size[0] * size[1]:
            return None
    elif array == "irregular":
        order = np.random.default_rng(0).permutation(len(lf.views))
        others = [n for n in order if n != lf.reference_index][: _IRREGULAR - 1]
        chosen = np.sort(np.array([lf.reference_index, *others]))
    else:
        line = lf.subset(array)
        chosen = np.array([lf.index_of(v, u) for u, v in line.positions])
    if indices is not None:
        indices.extend(int(n) for n in chosen)
    return lf.subset([int(n) for n in chosen])


def _window(lf: LightField, crop: int) -> tuple[int, int, tuple[int, int]]:
    height, width = (min(side, crop) for side in lf.size)
    return (lf.size[0] - height) // 2, (lf.size[1] - width) // 2, (height, width)


def _cropped(lf: LightField, crop: int) -> LightField:
    top, left, (height, width) = _window(lf, crop)
    return lf.crop(slice(top, top + height), slice(left, left + width))


def _range(lf: LightField, level: float = 0.0) -> tuple[float, float]:
    """The true range of disparities, all of which are higher by `level`."""
    truth = lf.reference_truth()
    if truth is None:
        raise BenchmarkError(f"{lf.name} has no truth of its reference view to score by.")
    return (
        float(np.nanmin(truth.disparity)) - _MARGIN + level,
        float(np.nanmax(truth.disparity)) + _MARGIN + level,
    )


def _scored(lf: LightField, plan: Plan, level: float = 0.0) -> Scores:
    """Scores of a map with the true range, moved by `level`."""
    truth = lf.reference_truth()
    assert truth is not None
    bounds = _range(lf, level)
    result: DepthResult = estimate_depth(
        lf,
        config=plan.preset,  # type: ignore[arg-type]
        disparity_range=bounds,
        device=plan.device,
        check_cameras=False,
    )
    found = evaluate(result, truth)
    error = float(np.nanmedian(result.disparity - truth.disparity))
    levelled = evaluate(result.disparity - error, truth)
    return Scores(found.mse_100, found.badpix_07, found.badpix_03, found.badpix_01, levelled.badpix_03)


def _left(
    lf: LightField,
    cameras: Sequence[Camera],
    homographies: NDArray[np.float64] | None,
    moved: NDArray[np.float64] | None,
) -> float | None:
    """Shift of the views, rms along each axis, of where pixels are looked up against where they should be."""
    if moved is not None and moved.any():
        return None  # what parallax does of it differs from pixel to pixel
    rest = consensus.without_gauge(_shifts(lf, cameras, homographies), lf.offsets)
    return float(np.sqrt((rest**2).mean()))


def _level(lf: LightField, cameras: Sequence[Camera]) -> float:
    """By how much the shifts of the cameras raise all disparities, pixels per view step."""
    return float((_shifts(lf, cameras, None) * lf.offsets).sum() / (lf.offsets**2).sum())


def _shifts(lf: LightField, cameras: Sequence[Camera], homographies: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """[n, 2], pixels to the right and down from where things should be to where they are looked up, on average."""
    height, width = lf.size
    y, x = np.mgrid[: height - 1 : 7j, : width - 1 : 7j]
    pixels = np.stack([x, y], axis=-1)
    shifts = []
    for n, (ideal, real) in enumerate(zip(ideal_cameras(lf), cameras, strict=True)):
        should = real.project(ideal.rays(pixels) @ np.asarray(ideal.rotation) @ np.asarray(real.rotation).T)
        looked_up = pixels if homographies is None else through(homographies[n], pixels)
        shifts.append((looked_up - should).mean(axis=(0, 1)))
    return np.array(shifts)


def load(path: Path) -> list[Row]:
    """The rows of a file; BenchmarkError if it is none of these."""
    scores = ("right", "wrong", "refined")
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
        return [Row(**{**row, **{name: Scores(**row[name]) for name in scores}}) for row in rows]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchmarkError(f"{path} holds no rows of `benchmarks misalignment`.") from error


def show(rows: list[Row]) -> None:
    """A table."""
    table = Table()
    for name in ("scene", "array", "disturbance", "BadPix(.03): right", "wrong", "refined", "level: right", "refined"):
        table.add_column(name, justify="left" if name in ("scene", "array", "disturbance") else "right")
    table.add_column("off, px", justify="right")
    table.add_column("left, px", justify="right")
    for row in rows:
        numbers = (row.right.badpix_03, row.wrong.badpix_03, row.refined.badpix_03)
        levels = (row.right.level_03, row.refined.level_03)
        table.add_row(
            row.scene,
            row.array,
            row.disturbance,
            *(f"{number:.1f}" for number in (*numbers, *levels)),
            *("–" if shift is None else f"{shift:.3f}" for shift in (row.off_px, row.left_px)),
        )
    Console(width=150).print(table)

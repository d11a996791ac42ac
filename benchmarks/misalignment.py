"""Errors of maps with misaligned cameras, before and after self-calibration."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from benchmarks import scoring
from benchmarks.errors import BenchmarkError
from benchmarks.options import DeviceName, Out, Preset, Row, Scenes, check_out, collected, listed, say
from benchmarks.tables import NONE, Columns, Table
from lfgpu import DepthResult, LightField, estimate_depth, evaluate, read, scenes
from lfgpu.calibration import Camera, Misalignment, disturb, refine
from lfgpu.calibration.misalign import displacements
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.calibration.resample import through
from lfgpu.cameras import consensus
from lfgpu.errors import LightFieldError

ARRAYS = ("9x9", "5x5", "star", "row", "irregular")
"""Views of a light field that are used: a middle part of its grid, lines of it, or 12 cameras in no grid."""

DISTURBANCES = ("shift=1", "gain=0.1", "roll=0.1", "scale=0.002", "shift=1,gain=0.1,roll=0.1,scale=0.002,offset=0.01")
"""As of `lfgpu scene --misalign`; "position=..." only on scenes of the package, which are rendered from there."""

_IRREGULAR = 12


COLUMNS: Columns = {
    "scene": "{scene}",
    "array": "{array}",
    "disturbance": "{disturbance}",
    "BadPix(.03): right": "{right[badpix_03]:.1f}",
    "wrong": "{wrong[badpix_03]:.1f}",
    "refined": "{refined[badpix_03]:.1f}",
    "level: right": "{right[level_03]:.1f}",
    "level: refined": "{refined[level_03]:.1f}",
    "off, px": lambda row: _pixels(row["off_px"]),
    "left, px": lambda row: _pixels(row["left_px"]),
}


def _pixels(shift: float | None) -> str:
    return NONE if shift is None else f"{shift:.3f}"


def table(rows: Sequence[Row]) -> Table:
    """Make the table: BadPix(0.03) less the median error with right, wrong and lined up cameras, and the shifts."""
    arrays = {"star": "star of {}", "row": "row of {}", "irregular": "{} in no grid"}

    def array(row: Row) -> str:
        return arrays.get(row["array"], row["array"].replace("x", " × ")).format(row["views"])

    def disturbance(row: Row) -> str:
        return "all five" if row["disturbance"].count(",") == 4 else row["disturbance"].replace("=", " ")

    columns: Columns = {
        "scene, views, px": lambda r: f"`{r['scene']}`, {array(r)}, {r['crop']}",
        "disturbance": disturbance,
        "undisturbed": "{right[level_03]:.1f}",
        "disturbed": "{wrong[level_03]:.1f}",
        "lined up": "{refined[level_03]:.1f}",
        "shifts before": COLUMNS["off, px"],
        "after": COLUMNS["left, px"],
    }
    made = Table.of("", 2, rows, columns)
    return replace(made, rows=sorted(made.rows))


@dataclass(frozen=True)
class Plan:
    """The measurements to make; `crop` is the longest side of the middle of views that maps are made of, pixels."""

    scenes: tuple[str, ...]
    arrays: tuple[str, ...]
    disturbances: tuple[str, ...]
    seeds: int
    crop: int
    preset: str
    device: str | None


def command(
    scene_names: Scenes,
    arrays: Annotated[str, typer.Option(metavar="NAME,...", help="Arrays of views.")] = ",".join(ARRAYS),
    disturbances: Annotated[
        list[str] | None,
        typer.Option("--misalign", metavar="WHAT", help="As of `lfgpu scene`; may be repeated. Default: five of them."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Draws of each disturbance.")] = 1,
    crop: Annotated[int, typer.Option(min=64, help="Longest side of the middle of the views that is used.")] = 512,
    preset: Preset = "accurate",
    device: DeviceName = None,
    append: Annotated[bool, typer.Option("--append", help="Add to the rows that the output has.")] = False,
    out: Out = None,
) -> None:
    """Score maps with cameras as they should be, misaligned, and lined up by `refine`, with the true range."""
    check_out(out)
    chosen = tuple(disturbances or DISTURBANCES)
    plan = Plan(tuple(scene_names), tuple(listed(arrays)), chosen, seeds, crop, preset, device)
    before = load(out) if append and out is not None and out.exists() else []
    Table.of("", 3, collected(run(plan), out, benchmark="misalignment", before=before), COLUMNS).show()


def run(plan: Plan) -> Iterator[Row]:
    """Measure all disturbances of all arrays of all scenes: errors with cameras that are right, wrong, and lined up.

    `off_px` and `left_px` are the shifts of the views, rms along each axis, before and after, against what the cameras
    are, without what views cannot tell; None where cameras stand beside their places.
    """
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
    right: dict[str, float],
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
    return {
        **{"scene": Path(scene).name, "array": array, "views": len(chosen.views), "crop": max(size)},
        **{"disturbance": how, "seed": seed, "preset": plan.preset, "right": right},
        "wrong": _scored(wrong, plan, level),
        "refined": _scored(refined, plan, level),
        "off_px": _left(wrong, cameras, None, moved),
        "left_px": _left(wrong, cameras, homographies, moved),
        "status": status,
    }


# --- steps ---


def recording(scene: str) -> Callable[[NDArray[np.float64] | None], LightField]:
    """Return a source of a light field: a folder, or a scene of the package by name and seed, "boxes-11".

    A scene of the package is rendered from displaced cameras if asked.
    """
    name, _, seed = scene.partition("-")
    if name in scenes.NAMES and not Path(scene).exists():
        if not (seed or "7").isdecimal():
            raise BenchmarkError(f"unknown scene {scene!r}; write NAME-SEED, as boxes-11.")
        number = int(seed or "7")
        return lambda moved: scenes.make(name, grid=(9, 9), size=(256, 256), seed=number, noise=0.004, displaced=moved)
    ((_, path),) = scoring.light_fields([Path(scene)]).items()
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
    """Choose the views of an array, and append their indices; None where the light field does not have them."""
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


def _range(lf: LightField, level: float) -> tuple[float, float]:
    """Return the true range of disparities, all of which are higher by `level`."""
    low, high = scoring.true_range(lf)
    return low + level, high + level


def _scored(lf: LightField, plan: Plan, level: float = 0.0) -> dict[str, float]:
    """Score a map with the true range, moved by `level`.

    `level_03` is BadPix(0.03) less the median error: a shift of all views in proportion to their offsets is another
    plane of disparity 0, which no view tells.
    """
    truth, bounds = scoring.truth_of(lf), _range(lf, level)
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
    scores = {name: getattr(found, name) for name in ("mse_100", "badpix_07", "badpix_03", "badpix_01")}
    return {**scores, "level_03": levelled.badpix_03}


def _left(
    lf: LightField,
    cameras: Sequence[Camera],
    homographies: NDArray[np.float64] | None,
    moved: NDArray[np.float64] | None,
) -> float | None:
    """Measure the shift of the views, rms along each axis: where pixels are looked up, less where they should be."""
    if moved is not None and moved.any():
        return None  # what parallax does of it differs from pixel to pixel
    rest = consensus.without_gauge(_shifts(lf, cameras, homographies), lf.offsets)
    return float(np.sqrt((rest**2).mean()))


def _level(lf: LightField, cameras: Sequence[Camera]) -> float:
    """Measure how far the shifts of the cameras raise all disparities, pixels per view step."""
    return float((_shifts(lf, cameras, None) * lf.offsets).sum() / (lf.offsets**2).sum())


def _shifts(lf: LightField, cameras: Sequence[Camera], homographies: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Measure the mean way from where things should be to where they are looked up, [n, 2], pixels right and down."""
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
    """Read the rows of a file; BenchmarkError if it has none."""
    try:
        rows: list[Row] = json.loads(path.read_text(encoding="utf-8"))["rows"]
        table(rows)
        return rows
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchmarkError(f"{path} holds no rows of `benchmarks misalignment`.") from error

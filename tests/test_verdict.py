"""One verdict: every way to a map gives the same notes and the same remarks, in the same order."""

import queue
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from command_line import said as succeeded
from test_range_confirmation import noise_in_a_row

import lfgpu
from lfgpu import scenes
from lfgpu.batch.items import Item
from lfgpu.batch.manifest import DONE
from lfgpu.batch.work import Job, Settings, work
from lfgpu.calibration import Misalignment, disturb
from lfgpu.data import DepthResult, LightField
from lfgpu.io import write_hci
from lfgpu.methods import PresetName, method_of, preset
from lfgpu.pipelines.verdict import Verdict
from lfgpu.viewer.solving import Request, Solver

Said = tuple[tuple[str, ...], tuple[str, ...]]


@cache
def right() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(96, 112), seed=3, noise=0.004)


@cache
def askew() -> LightField:
    return disturb(right(), Misalignment(shift=0.5), seed=1).light_field


@cache
def blank() -> LightField:
    return replace(LightField.from_grid(noise_in_a_row((9, 96, 112, 3), 0, 1).reshape(3, 3, 96, 112, 3)), name="blank")


FAULTS: dict[str, tuple[Callable[[], LightField], tuple[float, float], str, str]] = {
    "none": (right, (-3.0, 3.0), "", ""),
    "the range excludes the scene": (right, (3.0, 5.0), "may be wrong everywhere", ""),
    "the range ends within the scene": (right, (0.3, 3.0), "lies at its far end", ""),
    "cameras askew": (askew, (-3.0, 3.0), "", "out of line"),
    "cameras askew and a small range": (askew, (0.3, 3.0), "lies at its far end", "out of line"),
    "no texture": (blank, (-2.0, 2.0), "The map means nothing", ""),
}


def said(result: DepthResult) -> Said:
    return result.notes, result.remarks


def by_estimate(lf: LightField, given: tuple[float, float], _: Path) -> Said:
    return said(lfgpu.estimate_depth(lf, config="fast", disparity_range=given, device="cpu"))


def by_pipeline(lf: LightField, given: tuple[float, float], _: Path) -> Said:
    """What the map alone tells is a part of the verdict, and the rest comes on demand."""
    result = lfgpu.DepthPipeline(lf, config="fast", disparity_range=given, device="cpu").estimate()
    whole = lfgpu.judged(lf, result, disparity_range=given, device="cpu")
    if "means nothing" not in "".join(whole.notes):
        assert set(result.notes) <= set(whole.notes)
    return said(whole)


def by_tiles(lf: LightField, given: tuple[float, float], _: Path) -> Said:
    return said(lfgpu.estimate_depth(lf, config="fast", disparity_range=given, device="cpu", max_memory="1GiB"))


def by_all_views(lf: LightField, given: tuple[float, float], _: Path) -> Said:
    found = lfgpu.estimate_all_views(lf, keys=2, config="fast", disparity_range=given, device="cpu")
    return said(found.reference)


def by_viewer(lf: LightField, given: tuple[float, float], _: Path) -> Said:
    done: queue.SimpleQueue[Said] = queue.SimpleQueue()
    solver = Solver(lambda _: None, lambda _, result: done.put(said(result)))
    assert solver.start(Request(lf, preset("fast"), given))
    return done.get(timeout=600.0)


def by_command(lf: LightField, given: tuple[float, float], folder: Path, *more: str) -> Said:
    options = ["--preset=fast", f"--disparity-range={given[0]},{given[1]}", "--device=cpu", *more]
    text = succeeded("depth", folder / "lf", "-o", folder / "out", *options)
    found = said(lfgpu.load(folder / "out" / "result.npz"))
    printed = " ".join(text.split())
    places = [printed.find(sentence) for sentence in (*found[0], *found[1])]
    assert min(places, default=0) >= 0
    assert places == sorted(places)
    return found


def by_command_for_all_views(lf: LightField, given: tuple[float, float], folder: Path) -> Said:
    return by_command(lf, given, folder, "--all-views")


def by_batch(lf: LightField, given: tuple[float, float], folder: Path) -> Said:
    settings = Settings(preset("fast"), disparity_range=given)
    entry = work(Job(Item("item", str(folder / "lf")), settings, str(folder / "batch")), "cpu")
    assert entry["status"] == DONE, entry
    found = said(lfgpu.load(folder / "batch" / "item" / "result.npz"))
    assert (tuple(entry["notes"]), tuple(entry["remarks"])) == ((*lf.notes, *found[0]), found[1])
    return found


WAYS = (by_pipeline, by_tiles, by_all_views, by_viewer, by_command, by_command_for_all_views, by_batch)


QUICK = ("none", "cameras askew and a small range", "no texture")
"""Of each kind of sentence one, and none."""


@pytest.mark.parametrize(
    "fault", [pytest.param(name, marks=() if name in QUICK else pytest.mark.thorough) for name in FAULTS]
)
def test_all_ways_say_the_same_in_the_same_order(fault: str, tmp_path: Path) -> None:
    make, given, note, remark = FAULTS[fault]
    write_hci(make(), tmp_path / "lf")
    lf = lfgpu.read(tmp_path / "lf")
    notes, remarks = by_estimate(lf, given, tmp_path)
    assert note in " ".join(notes)
    assert remark in " ".join(remarks)
    assert bool(notes) == bool(note)
    assert bool(remarks) == bool(remark)
    for way in WAYS:
        assert way(lf, given, tmp_path) == (notes, remarks), way.__name__


def test_disparities_that_lie_far_apart_in_a_wide_range_are_a_note() -> None:
    lf, bounds = right(), (-3.0, 3.0)
    config = preset("fast").with_values({"sweep.max_labels": 8})
    result = lfgpu.estimate_depth(lf, config=config, disparity_range=bounds, device="cpu", check_cameras=False)
    assert [note for note in result.notes if "the 8 disparities that are compared lie 1 px apart" in note]
    again = lfgpu.judged(lf, result, disparity_range=bounds, device="cpu", check_cameras=False)
    assert again.notes == result.notes
    assert method_of("fast").doubt(lf.layout, bounds) is None
    in_metres = replace(lf, positions=lf.positions / 50, grid_shape=None, truth=None)
    assert "stands 0.028 view steps from" in Verdict().on(in_metres, result).notes[0]
    assert method_of("paper").doubt(lf.layout, bounds) is None


def test_a_wide_range_is_a_note_on_what_limits_the_preset() -> None:
    layout = scenes.make("planes", grid=(3, 3), size=(32, 32)).layout

    def doubt(name: PresetName, width: float, most: int = 256) -> str:
        config = preset(name).with_values({"sweep.max_labels": most})
        return method_of(config).doubt(layout, (0.0, width)) or ""

    assert not doubt("learned", 29.0)
    assert "the 64 disparities that are compared lie 0.68 px apart in the farthest view of the network" in doubt(
        "learned", 40.0, most=4096
    )
    assert "max_labels" not in doubt("learned", 400.0)
    assert not doubt("surest", 100.0)  # the sweeps miss nothing there
    assert not doubt("surest", 29.0, most=8)  # the network misses nothing
    assert "a larger sweep.max_labels" in doubt("surest", 400.0)
    assert not doubt("surest", 400.0, most=4096)


def test_maps_of_all_views_are_less_confident_where_cameras_are_askew() -> None:
    options = {"keys": 2, "config": "fast", "disparity_range": (-3.0, 3.0), "device": "cpu"}
    before = lfgpu.estimate_all_views(askew(), **options, check_cameras=False)  # type: ignore[arg-type]
    after = lfgpu.estimate_all_views(askew(), **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(after.disparities, before.disparities)
    means = (after.confidences.mean((1, 2)), before.confidences.mean((1, 2)))
    assert (means[0] < means[1] - 0.1).all()


def test_views_in_memory_of_fewer_bits_are_asked_for_white() -> None:
    """Files have it found; of an array it cannot be known."""
    lf = right()
    for bits in (8, 12):
        white = (1 << bits) - 1
        few = replace(lf, views=np.round(lf.views * (white / 255)).astype(np.uint16))
        given = replace(few, white=white)
        assert few.views.dtype == np.uint16
        notes = [by_estimate(views, (-3.0, 3.0), Path())[0] for views in (few, given)]
        assert [
            note for note in notes[0] if f"as those of {bits} bits do: give the light field white={white} if" in note
        ]
        assert notes[1] == ()


def test_what_is_no_result_cannot_be_judged() -> None:
    lf = scenes.make("boxes", grid=(1, 3), size=(40, 48))
    with pytest.raises(lfgpu.LightFieldError, match="result must be what an estimate returned, found NoneType"):
        lfgpu.judged(lf, None)  # type: ignore[arg-type]
    for use in (partial(lfgpu.reasons, lf), lfgpu.point_cloud):
        with pytest.raises(lfgpu.LightFieldError, match=r"result must be what an estimate.* found ndarray"):
            use(np.zeros((40, 48)))  # type: ignore[operator]
    with pytest.raises(lfgpu.LightFieldError, match="lf must be a LightField, found NoneType"):
        lfgpu.judged(None, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [(2, -2), (float("nan"), 1), 5, "x", (-(10**400), 1)], ids=str)
def test_a_map_is_not_judged_by_a_range_that_is_none(wrong: object) -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=("-2", "2"), check_cameras=False)  # type: ignore[arg-type]
    assert result.disparity_range == (-2.0, 2.0)
    with pytest.raises(lfgpu.LightFieldError, match="disparity range must be two finite numbers"):
        lfgpu.judged(lf, result, disparity_range=wrong)  # type: ignore[arg-type]

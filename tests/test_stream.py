"""A stream gives each frame the map that a pipeline gives, counts everything, and nothing that is pushed ends it."""

from __future__ import annotations

import gc
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.data.lightfield import LightField
from lfgpu.pipelines.range_watch import RangeWatch

RANGE = (-1.5, 1.5)
FRAMES = 6
LONG = 600.0  # seconds: nothing takes that long unless it hangs


@cache
def frames() -> tuple[LightField, ...]:
    """A scene that moves slowly: the first frames of many."""
    options: dict[str, Any] = {"grid": (3, 5), "size": (40, 44), "noise": 0.01}
    return tuple(lf for lf, _ in zip(scenes.sequence("moving", frames=90, **options), range(FRAMES), strict=False))


@cache
def other_scene() -> LightField:
    return scenes.make("planes", seed=3, grid=(3, 5), size=(40, 44))


@cache
def alone(config: str, index: int) -> np.ndarray:
    """What a pipeline that was made for the first frame makes of a later one."""
    pipeline = lfgpu.DepthPipeline(frames()[0], config=config, disparity_range=RANGE, device="cpu")
    pipeline.upload(frames()[index].views)
    pipeline.run()
    return pipeline.disparity()


def made(lf: LightField | None = None, **options: Any) -> lfgpu.DepthStream:
    options = {"config": "fast", "disparity_range": RANGE, "device": "cpu", "policy": "block", **options}
    return lfgpu.DepthStream(lf or frames()[0], **options)


@contextmanager
def held(stream: lfgpu.DepthStream) -> Iterator[None]:
    """The stream gets no further than the frame that it works on."""
    with load("warp").asking(stream.device):
        yield


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end, "it hangs"
        time.sleep(0.001)


def adds_up(stats: dict[str, Any]) -> bool:
    ends = sum(stats[f"frames_{name}"] for name in ("done", "dropped", "failed", "in_work"))
    return bool(stats["frames_pushed"] == ends)


# --- maps ---


@pytest.mark.parametrize("config", ["accurate", "fast"])
def test_without_a_prior_each_map_is_that_of_a_pipeline(config: str) -> None:
    with made(config=config, prior=None) as stream:
        results = [stream.push(lf.views) for lf in frames()[:3]]
        for index, result in enumerate(results):
            np.testing.assert_array_equal(result.numpy(), alone(config, index))
            assert (result.index, result.cold, result.cut) == (index, True, False)


@pytest.mark.parametrize(("config", "bounds"), [("accurate", RANGE), ("fast", None)])
def test_first_map_is_that_of_estimate_depth(config: str, bounds: tuple[float, float] | None) -> None:
    want = lfgpu.estimate_depth(frames()[0], config=config, disparity_range=bounds, device="cpu")
    with made(config=config, disparity_range=bounds) as stream:
        assert stream.bounds == want.disparity_range
        result = stream.push(frames()[0].views)
        np.testing.assert_array_equal(result.numpy(), want.disparity)
        np.testing.assert_array_equal(result.confidence(), want.confidence)


def test_warm_maps_are_near_the_cold_ones_and_flicker_less() -> None:
    with made() as stream:
        results = [stream.push(lf.views) for lf in frames()]
        warm = [result.numpy() for result in results]
    assert [result.cold for result in results] == [True] + [False] * (FRAMES - 1)
    cold = [alone("fast", index) for index in range(FRAMES)]
    truth = [lf.truth.disparity for lf in frames() if lf.truth is not None]
    still = np.abs(np.diff(truth, axis=0)).max(0) == 0
    assert still.mean() > 0.2

    def flicker(maps: list[np.ndarray]) -> float:
        return float(np.median(np.abs(np.diff(maps[1:], axis=0))[:, still]))

    def error(maps: list[np.ndarray]) -> float:
        return float(np.median([np.median(np.abs(one - true)) for one, true in zip(maps, truth, strict=True)]))

    assert flicker(warm) < 0.7 * flicker(cold)
    assert error(warm) < 1.15 * error(cold)


def test_scene_cut_starts_cold() -> None:
    """And so the frame after it has the map that it has alone."""
    with made() as stream:
        first, cut = stream.push(other_scene().views), stream.push(frames()[1].views)
        np.testing.assert_array_equal(cut.numpy(), alone("fast", 1))
        assert (first.cut, cut.cut, cut.cold) == (False, True, True)
        assert stream.stats()["scene_cuts"] == 1


def test_restart_forgets() -> None:
    with made() as stream:
        stream.push(frames()[0].views).wait()
        stream.restart()
        np.testing.assert_array_equal(stream.push(frames()[1].views).numpy(), alone("fast", 1))


def test_cameras_drop_out_and_come_back() -> None:
    """Without them the map is that of a light field in which they are masked, whatever their views hold."""
    lf, there = frames()[0], np.ones(15, bool)
    there[[0, 5, 9]] = False
    valid = np.broadcast_to(there[:, None, None], lf.views.shape[:3]).copy()
    masked = LightField(lf.views, lf.positions, reference=lf.reference, valid=valid)
    config = lfgpu.PRESETS["accurate"].with_values({"sweep.noise": 0.01})
    want = lfgpu.estimate_depth(masked, config=config, disparity_range=RANGE, device="cpu").disparity
    whole = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").disparity
    views = lf.views.copy()
    views[~there] = 255
    with made(config=config, prior=None) as stream:
        assert np.array_equal(stream.push(lf.views).numpy(), whole)
        assert np.array_equal(stream.push(views, valid=there).numpy(), want)
        assert np.array_equal(stream.push(lf.views).numpy(), whole)
        assert stream.stats()["frames_with_missing_views"] == 1
    assert not np.array_equal(want, whole)


def test_cameras_of_a_large_grid_drop_out_and_come_back() -> None:
    """Every other one is swept at first: masks go with them."""
    lf, there = scenes.make("planes", grid=(9, 9), size=(32, 40), seed=1), np.ones(81, bool)
    there[[50, 59]] = False  # one of either kind
    valid = np.broadcast_to(there[:, None, None], lf.views.shape[:3]).copy()
    config = lfgpu.PRESETS["accurate"].with_values({"sweep.noise": 0.01})
    want, whole = (
        lfgpu.estimate_depth(one, config=config, disparity_range=RANGE, device="cpu").disparity
        for one in (replace(lf, valid=valid), lf)
    )
    views = lf.views.copy()
    views[~there] = 255
    with made(lf, config=config, prior=None) as stream:
        assert np.array_equal(stream.push(lf.views).numpy(), whole)
        assert np.array_equal(stream.push(views, valid=there).numpy(), want)
    assert not np.array_equal(want, whole)
    with made(lf, config=config) as stream:
        stream.push(lf.views).wait()
        warm = stream.push(lf.views).numpy()
    assert np.median(np.abs(warm - whole)) < 0.01


def test_masks_of_the_light_field_stay() -> None:
    lf = frames()[0]
    valid = np.ones(lf.views.shape[:3], bool)
    valid[:, :6, :9] = False
    masked = LightField(lf.views, lf.positions, reference=lf.reference, valid=valid)
    want = lfgpu.estimate_depth(masked, config="fast", disparity_range=RANGE, device="cpu").disparity
    there = np.ones(15, bool)
    there[5] = False
    with made(masked, prior=None) as stream:
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)
        assert not np.array_equal(stream.push(lf.views, valid=there).numpy(), want, equal_nan=True)
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)


def test_what_the_reference_did_not_record_is_unknown_in_warm_maps_too() -> None:
    """Although the past holds numbers there, for the sums of neighbours."""
    lf = frames()[0]
    valid = np.ones(lf.views.shape[:3], bool)
    valid[7, 10:22, 12:30] = False
    masked = LightField(lf.views, lf.positions, reference=lf.reference, valid=valid)
    with made(masked) as stream:
        results = [stream.push(frame.views) for frame in frames()]
        maps = [result.numpy() for result in results]
        trust = [result.confidence() for result in results]
    assert [result.cold for result in results] == [True] + [False] * (FRAMES - 1)
    for disparity, confidence in zip(maps, trust, strict=True):
        np.testing.assert_array_equal(np.isnan(disparity), ~valid[7])
        assert (confidence[~valid[7]] == 0).all()
    beside = np.zeros_like(valid[7])
    beside[9:23, 11:31] = True
    beside &= valid[7]
    assert (maps[-1][beside] > RANGE[0] + 0.01).all()


def test_before_there_is_a_frame() -> None:
    lf = frames()[0]
    config = lfgpu.PRESETS["fast"].with_values({"sweep.noise": 0.01})
    want = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").disparity
    with lfgpu.DepthStream.for_cameras(
        lf.positions, lf.size, disparity_range=RANGE, noise=0.01, config="fast", device="cpu", reference=lf.reference
    ) as stream:
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)


# --- what frames may be ---


class Foreign:
    """An array that has nothing but DLPack."""

    def __init__(self, values: np.ndarray) -> None:
        self._values, self.shape, self.dtype = values, values.shape, values.dtype

    def __dlpack__(self, **options: Any) -> Any:
        return self._values.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._values.__dlpack_device__()


def test_forms_of_a_frame() -> None:
    views = frames()[0].views
    strided = np.repeat(views, 2, axis=2)[:, :, ::2]
    assert not strided.flags.c_contiguous
    with made(prior=None) as stream:
        want = stream.push(views).numpy()
        for form in (strided, views.reshape(3, 5, *views.shape[1:]), Foreign(views)):
            assert np.array_equal(stream.push(form).numpy(), want)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_other_types_of_values(dtype: type) -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 32), dtype=dtype, channels=1, disparity_range=(-1, 1))
    want = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-1, 1), device="cpu").disparity
    with made(lf, disparity_range=(-1, 1)) as stream:
        assert np.array_equal(stream.push(lf.views[..., 0]).numpy(), want)


def test_a_frame_may_be_changed_at_once() -> None:
    views = frames()[0].views.copy()
    with made(prior=None) as stream:
        with held(stream):
            result = stream.push(views)
            views[:] = 0
        np.testing.assert_array_equal(result.numpy(), alone("fast", 0))


def test_bad_frames_fail_alone() -> None:
    views, there = frames()[0].views, np.ones(15, bool)
    no_reference, lonely = there.copy(), ~there
    no_reference[7], lonely[7] = False, True
    bad: list[tuple[Any, Any, str]] = [
        (views[:, :8], None, r"uint8 \[15, 8, 44, 3\]"),
        (views.astype(np.float32), None, "found float32"),
        ("a picture", None, "must be an array"),
        (views, there[:3], r"valid must be bool \[15\]"),
        (views, no_reference, "reference view .* missing"),
        (views, lonely, "only the reference view"),
        (np.zeros_like(views), None, "no texture"),
    ]
    with made() as stream:
        for index, (frame, valid, sentence) in enumerate(bad):
            result = stream.push(frame, valid=valid, tag=index)
            with pytest.raises(lfgpu.LightFieldError, match=sentence):
                result.numpy()
            assert result.error is not None
            assert not result.dropped
            assert result.tag == index
        np.testing.assert_array_equal(stream.push(views).numpy(), alone("fast", 0))
        stats = stream.stats()
    assert (stats["frames_failed"], stats["frames_done"]) == (len(bad), 1)


def test_what_is_not_finite_fails_unless_it_does_not_count() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 32), dtype=np.float32, disparity_range=(-1, 1))
    views, there = lf.views.copy(), np.ones(9, bool)
    views[3, 5, 5, 1], there[3] = np.nan, False
    with made(lf, disparity_range=(-1, 1)) as stream:
        with pytest.raises(lfgpu.LightFieldError, match=r"view 3 holds NaN or infinity"):
            stream.push(views).numpy()
        assert np.isfinite(stream.push(views, valid=there).numpy()).all()


def test_float_frames_in_another_unit_are_refused() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 32), dtype=np.float32, disparity_range=(-1, 1))
    with made(lf, disparity_range=(-1, 1)) as stream:
        with pytest.raises(lfgpu.LightFieldError, match=r"view \d has values from .* scale float views to \[0, 1\]"):
            stream.push(lf.views * 255).numpy()
        assert np.isfinite(stream.push(lf.views).numpy()).all()


def test_float_frames_in_another_unit_are_seen_on_the_device_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """As frames that lie on a GPU are, which the host does not look at."""
    lf = scenes.make("planes", grid=(3, 3), size=(32, 32), dtype=np.float32, disparity_range=(-1, 1))
    monkeypatch.setattr("lfgpu.pipelines.intake.check_scaled", lambda *_: None)
    with made(lf, disparity_range=(-1, 1)) as stream:
        with pytest.raises(lfgpu.LightFieldError, match=r"scale float views"):
            stream.push(lf.views * 255).numpy()
        result = stream.push(lf.views)
        assert np.isfinite(result.numpy()).all()
        assert result.cold


# --- the disparity range ---


@pytest.mark.parametrize(("bounds", "end"), [((-1.5, 0.0), "near"), ((0.3, 1.5), "far")])
def test_a_range_that_is_too_small_is_said_so(
    bounds: tuple[float, float], end: str, caplog: pytest.LogCaptureFixture
) -> None:
    with made(disparity_range=bounds) as stream:
        results = [stream.push(lf.views) for lf in frames()]
        assert all(result.wait(LONG) for result in results)
    assert stream.stats()["frames_beyond_range"] == FRAMES
    assert len(stream.warnings) == stream.stats()["warnings"] == 1
    assert f"move the {end} end further out" in stream.warnings[0]
    assert [record.getMessage() for record in caplog.records] == list(stream.warnings)


@pytest.mark.parametrize("config", ["accurate", "fast"])
def test_a_range_that_holds_the_scene_is_not(config: str) -> None:
    truth = [lf.truth.disparity for lf in frames() if lf.truth is not None]
    bounds = float(np.min(truth)) - 0.05, float(np.max(truth)) + 0.05
    with made(config=config, disparity_range=bounds) as stream:
        for lf in frames():
            assert stream.push(lf.views).wait(LONG)
    assert stream.warnings == ()


def test_a_range_that_lacks_what_has_no_texture_is_said_so() -> None:
    """Its maps do not show that: hardly a pixel lies at an end."""
    lf = scenes.make("textureless", grid=(5, 5), size=(96, 96), seed=1, noise=0.005, disparity_range=(-1, 1))
    with made(lf, disparity_range=(-1.1, 0.2)) as stream:
        assert stream.push(lf.views).wait(LONG)
    assert stream.stats()["frames_beyond_range"] == 0
    (sentence,) = stream.warnings
    assert "the first views show" in sentence
    assert "move the near end" in sentence


def test_what_lies_at_an_end_by_chance_is_no_reason() -> None:
    """Half of the map has no texture, and is at an end of a range that holds the scene."""
    lf = frames()[0]
    truth = [lf.truth.disparity for lf in frames() if lf.truth is not None]
    bounds = float(np.min(truth)) - 0.05, float(np.max(truth)) + 0.05
    map_ = np.full(lf.size, 0.5 * sum(bounds), np.float32)
    map_[: len(map_) // 2] = bounds[1]
    for given, said in ((bounds, 0), ((bounds[0], bounds[0] + 0.5 * (bounds[1] - bounds[0])), 1)):
        watch = RangeWatch(given)
        assert watch.look(np.clip(map_, *given), is_new=False)
        assert watch.wait()
        assert len(watch.search(lf, "these views")) == said
        assert len(watch.warnings) == said
        assert watch.search(lf, "these views") == ()  # once


def test_a_search_is_wanted_after_a_cut_and_not_without_a_reason() -> None:
    watch = RangeWatch((-1.0, 1.0))
    assert not watch.look(np.zeros((8, 8), np.float32), is_new=False)
    assert not watch._wanted
    assert not watch.look(np.zeros((8, 8), np.float32), is_new=True)
    assert watch.wait()
    watch.close()
    assert not watch.wait()


# --- stamps ---


def test_frames_whose_pictures_were_not_taken_together_are_counted_and_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    lf = frames()[0]
    together = 7.0 + 0.001 * np.arange(15) / 15
    late = together.copy()
    late[5] += 0.02
    with made(tolerance=0.004) as stream:
        results = [stream.push(lf.views, stamps=stamps) for stamps in (together, late, late, None)]
        missing = np.arange(15) != 5
        late[5] = np.nan  # its stamp is not read, as its picture is not
        results.append(stream.push(lf.views, stamps=late, valid=missing))
        assert all(result.wait(LONG) and result.error is None for result in results)
    stats = stream.stats()
    assert (stats["frames_done"], stats["frames_out_of_step"], stats["warnings"]) == (5, 2, 1)
    (sentence,) = stream.warnings
    assert "frame 1 were taken within 20.2 ms" in sentence
    assert "view 5 " in sentence
    assert [record.getMessage() for record in caplog.records] == [sentence]
    assert results[1].stamps is not None
    assert results[1].stamps[5] == 7.02 + 0.001 * 5 / 15  # a copy: what became of `late` since is no matter
    assert results[3].stamps is None
    assert results[4].stamps is not None
    assert np.isnan(results[4].stamps).tolist() == (~missing).tolist()
    assert "lfgpu_stream_frames_out_of_step_total 2" in stream.prometheus()


def test_without_a_tolerance_any_stamps_will_do() -> None:
    with made() as stream:
        result = stream.push(frames()[0].views, stamps=np.arange(15.0))
        assert result.wait(LONG)
    assert result.error is None
    assert stream.warnings == ()


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (np.zeros(14), r"stamps must be \[15\], one for each view; found \[14\]"),
        (["noon"] * 15, "stamps must be numbers of seconds"),
        ([0.0] * 14 + [float("nan")], r"the stamp of view 14 is nan; give seconds, or set valid\[14\] to False"),
    ],
)
def test_wrong_stamps_fail_their_frame_only(stamps: Any, words: str) -> None:
    with made(tolerance=0.004) as stream:
        wrong = stream.push(frames()[0].views, stamps=stamps)
        right = stream.push(frames()[0].views, stamps=np.zeros(15))
        assert right.wait(LONG)
    assert right.error is None
    assert re.search(words, str(wrong.error))


@pytest.mark.parametrize("tolerance", [0, -1.0, float("nan"), True, "4 ms"])
def test_a_tolerance_is_a_number_of_seconds(tolerance: Any) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="tolerance must be a number of seconds > 0"):
        made(tolerance=tolerance)


# --- results ---


def test_results_keep_their_maps_and_give_them_back() -> None:
    with made() as stream:
        before = stream.stats()["result_buffers"]
        results = [stream.push(lf.views) for lf in frames()]
        maps = [np.asarray(result.device_disparity) for result in results]
        for shared, result in zip(maps, results, strict=True):
            np.testing.assert_array_equal(shared, result.numpy())
            assert np.shares_memory(shared, np.from_dlpack(result.device_disparity))
        copies = [one.copy() for one in maps]
        del results, result, shared
        gc.collect()
        for lf in frames():  # what is still held must not be written over
            stream.push(lf.views).wait()
        np.testing.assert_array_equal(maps, copies)
        held_up = stream.stats()["result_buffers"]
        del maps
        gc.collect()
        for _ in range(3 * before):
            stream.push(frames()[0].views).wait()
        assert stream.stats()["result_buffers"] == held_up


def test_a_closed_stream_returns_its_memory_and_results_keep_theirs() -> None:
    stream = made()
    result = stream.push(frames()[0].views)
    want = result.numpy()
    parts = [weakref.ref(part) for part in (stream._plan, stream._transport, stream._views)]
    stream.close()
    stream.close()
    gc.collect()
    assert [part() for part in parts] == [None] * 3
    assert stream.stats()["frames_done"] == 1
    np.testing.assert_array_equal(result.numpy(), want)
    np.testing.assert_array_equal(np.asarray(result.device_disparity), want)


def test_a_device_that_fails_is_said_so_and_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with made() as stream:
        with monkeypatch.context() as patch:
            patch.setattr(stream._transport, "solve", lambda *_: 1 / 0)
            failed = [stream.push(lf.views) for lf in frames()[:2]]
            assert all(result.wait(LONG) for result in failed)
        np.testing.assert_array_equal(stream.push(frames()[0].views).numpy(), alone("fast", 0))
    assert [str(result.error) for result in failed] == ["the device failed (division by zero)."] * 2
    assert caplog.text.count("Traceback") == 1


def test_callback_sees_every_result_and_may_fail() -> None:
    seen: list[int] = []

    def look(result: lfgpu.StreamResult) -> None:
        seen.append(result.index)
        assert result.numpy().shape == (40, 44)
        raise RuntimeError("the viewer is gone")

    with made(on_result=look) as stream:
        for lf in frames():
            stream.push(lf.views)
    assert seen == list(range(FRAMES))
    assert stream.stats()["callback_errors"] == FRAMES


def test_exceptions_of_a_callback_are_logged_once_with_their_place(caplog: pytest.LogCaptureFixture) -> None:
    def look(result: lfgpu.StreamResult) -> None:
        raise RuntimeError(f"the viewer is gone at {result.index}")

    with made(on_result=look) as stream:
        for lf in frames():
            stream.push(lf.views)
    records = [record for record in caplog.records if record.levelname == "ERROR"]
    assert [record.getMessage().split(";")[0] for record in records] == ["on_result failed with frame 0"]
    assert "the viewer is gone at 0" in caplog.text
    assert "in look" in caplog.text


def test_exceptions_of_a_callback_can_end_the_stream() -> None:
    called: list[int] = []

    def look(result: lfgpu.StreamResult) -> None:
        called.append(result.index)
        raise RuntimeError("the viewer is gone")

    with made(on_result=look, end_on_error=True) as stream:
        first = stream.push(frames()[0].views)
        until(lambda: stream._inbox.closed)
        assert first.error is None
        with pytest.raises(lfgpu.LfgpuError, match=r"on_result failed \(RuntimeError: the viewer is gone\)"):
            stream.push(frames()[1].views)
    assert called == [0]
    assert adds_up(stream.stats())


@pytest.mark.parametrize("ending", [SystemExit, KeyboardInterrupt, GeneratorExit])
def test_a_callback_that_ends_its_thread_does_not_end_the_stream(ending: type[BaseException]) -> None:
    def leave(result: lfgpu.StreamResult) -> None:
        raise ending

    with made(on_result=leave, policy="block") as stream:
        results = [stream.push(lf.views) for lf in frames()]
        assert all(result.wait(LONG) for result in results)
    assert stream.stats()["callback_errors"] == FRAMES


class _Odd:
    """An array of a library in which everything goes wrong."""

    def __init__(self, views: np.ndarray, method: str) -> None:
        self.dtype, self.shape, self._method = views.dtype, views.shape, method

    def __dlpack_device__(self) -> tuple[int, int]:
        if self._method == "device":
            raise OSError("the driver is gone")
        return (1, 0)

    def __dlpack__(self, **_: Any) -> Any:
        raise OSError("the driver is gone")


@pytest.mark.parametrize("method", ["device", "array"])
def test_a_frame_whose_library_fails_fails_alone(method: str) -> None:
    views = frames()[0].views
    with made() as stream:
        result = stream.push(_Odd(views, method))
        with pytest.raises(lfgpu.LightFieldError, match="the driver is gone"):
            result.numpy()
        np.testing.assert_array_equal(stream.push(views).numpy(), alone("fast", 0))


# --- under load ---


def test_latest_drops_what_waits() -> None:
    with made(policy="latest") as stream:
        with held(stream):
            first = stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            results = [stream.push(lf.views) for lf in frames()]
            assert [result.dropped for result in results] == [True] * (FRAMES - 1) + [False]
        assert first.wait(LONG)
        assert results[-1].wait(LONG)
        with pytest.raises(lfgpu.FrameDroppedError, match="frame 1"):
            results[0].numpy()
        stats = stream.stats()
    assert (stats["frames_done"], stats["frames_dropped"]) == (2, FRAMES - 1)


def test_queue_keeps_some() -> None:
    with made(policy="queue", waiting=3) as stream, held(stream):
        stream.push(frames()[0].views)
        until(lambda: stream.stats()["frames_waiting"] == 0)
        results = [stream.push(lf.views) for lf in frames()]
        assert [result.dropped for result in results] == [True] * (FRAMES - 3) + [False] * 3
    assert stream.stats()["frames_done"] == 4


def test_block_makes_those_who_push_wait() -> None:
    with made(policy="block", waiting=1) as stream, ThreadPoolExecutor(1) as pool:
        with held(stream):
            stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            stream.push(frames()[1].views)
            waits = pool.submit(stream.push, frames()[2].views)
            time.sleep(0.05)
            assert not waits.done()
        assert waits.result(LONG).wait(LONG)
    assert stream.stats()["frames_done"] == 3


@pytest.mark.parametrize("policy", ["latest", "block", "queue"])
def test_from_several_threads(policy: str) -> None:
    def push_some(seed: int) -> list[lfgpu.StreamResult]:
        random = np.random.default_rng(seed)
        return [stream.push(frames()[random.integers(FRAMES)].views) for _ in range(12)]

    with made(policy=policy) as stream, ThreadPoolExecutor(3) as pool:
        results = [result for part in pool.map(push_some, range(3)) for result in part]
        while not all(result.done for result in results):
            assert adds_up(stream.stats())
            time.sleep(0.002)
    assert sorted(result.index for result in results) == list(range(36))
    assert all(result.dropped or np.isfinite(result.numpy()).all() for result in results)
    stats = stream.stats()
    assert stats["frames_pushed"] == 36
    assert stats["frames_in_work"] == stats["frames_waiting"] == stats["frames_failed"] == 0
    assert stats["frames_dropped"] == sum(result.dropped for result in results)


@pytest.mark.parametrize("finish", [True, False])
def test_close_in_the_middle_of_work(finish: bool) -> None:
    before = threading.active_count()
    stream = made(policy="queue", waiting=4)
    with ThreadPoolExecutor(1) as pool:
        with held(stream):
            results = [stream.push(lf.views) for lf in frames()[:4]]
            closing = pool.submit(stream.close, finish=finish)
            until(lambda: stream._inbox.closed)
            with pytest.raises(lfgpu.LfgpuError, match="closed"):
                stream.push(frames()[0].views)
        closing.result(LONG)
    stream.close()
    assert all(result.done for result in results)
    assert finish or any(result.dropped for result in results)
    assert not finish or not any(result.dropped for result in results)
    stats = stream.stats()
    assert adds_up(stats)
    assert stats["frames_in_work"] == 0
    until(lambda: threading.active_count() <= before)


def test_close_wakes_those_who_wait() -> None:
    stream = made(policy="block", waiting=1)
    with ThreadPoolExecutor(2) as pool:
        with held(stream):
            stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            stream.push(frames()[1].views)
            waits = pool.submit(stream.push, frames()[2].views)
            time.sleep(0.02)
            closing = pool.submit(stream.close, finish=False)
            with pytest.raises(lfgpu.LfgpuError, match="closed"):
                waits.result(LONG)
        closing.result(LONG)
    assert adds_up(stream.stats())
    assert stream.stats()["frames_in_work"] == 0


def test_failing_block_drops_what_waits() -> None:
    with pytest.raises(KeyError), made(policy="queue") as stream:  # noqa: PT012 - the block is what is tested
        with held(stream):
            results = [stream.push(lf.views) for lf in frames()[:3]]
            stream._inbox.close(finish=False)
        raise KeyError
    assert all(result.done for result in results)


def test_two_streams_at_once() -> None:
    with made(prior=None) as one, made(config="accurate", prior=None) as other, ThreadPoolExecutor(2) as pool:

        def maps(stream: lfgpu.DepthStream) -> list[np.ndarray]:
            return [result.numpy() for result in [stream.push(lf.views) for lf in frames()[:3]]]

        found = list(pool.map(maps, (one, other)))
    for config, results in zip(("fast", "accurate"), found, strict=True):
        for index, disparity in enumerate(results):
            np.testing.assert_array_equal(disparity, alone(config, index))


# --- numbers ---


def test_budget_picks_the_work() -> None:
    """As much as fits by what it took; times are set, as those of this machine are not known."""
    config = lfgpu.PRESETS["accurate"].with_values({"alignment.iterations": 3})
    with made(config=config, budget_ms=10.0) as stream:
        for level in stream._cold:
            level.seconds = 1.0
        for steps, level in enumerate(stream._warm, 1):
            assert level.steps == steps
            level.seconds = 0.004 * steps
        first, second = (stream.push(lf.views) for lf in frames()[:2])
        assert first.wait(LONG)
        assert second.wait(LONG)
        assert (first.cold, first.steps, second.cold, second.steps) == (True, 1, False, 2)
        assert stream.stats()["frames_over_budget"] == sum(result.work > 0.01 for result in (first, second))
    with made(config=config) as stream:
        assert stream.push(frames()[0].views).wait(LONG)
        result = stream.push(frames()[1].views)
        assert result.wait(LONG)
        assert result.steps == 3


def test_stats_and_their_text() -> None:
    with made() as stream:
        assert np.isnan(stream.stats()["latency_p50_ms"])
        results = [stream.push(lf.views) for lf in frames()]
        assert all(result.wait(LONG) for result in results)
        stats = stream.stats()
        latencies = np.array([result.latency for result in results]) * 1000
        for quantile in (50, 95, 99):
            assert stats[f"latency_p{quantile}_ms"] == pytest.approx(np.percentile(latencies, quantile))
        assert all(0 < result.work <= result.latency for result in results)
        assert stats["frames_per_second"] > 0
        text = dict(line.rsplit(" ", 1) for line in stream.prometheus().splitlines() if not line.startswith("#"))
    assert float(text["lfgpu_stream_frames_done_total"]) == FRAMES
    assert float(text['lfgpu_stream_latency_seconds{quantile="0.99"}']) == pytest.approx(
        stats["latency_p99_ms"] / 1000, rel=1e-4
    )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"config": "paper"}, "synthesis cannot"),
        ({"config": 3}, "config must be"),
        ({"policy": "newest"}, "policy must be one of latest, block, queue"),
        ({"policy": "latest", "waiting": 2}, "waiting must be"),
        ({"waiting": 0}, "waiting must be"),
        ({"policy": "queue", "waiting": float("inf")}, "waiting must be"),
        ({"policy": "queue", "waiting": "x"}, "waiting must be"),
        ({"policy": "queue", "waiting": 10**9}, "waiting must be"),
        ({"cut": 2.0}, "cut must be"),
        ({"cut": "x"}, "cut must be"),
        ({"budget_ms": "x"}, "budget_ms must be"),
        ({"budget_ms": float("inf")}, "budget_ms must be"),
        ({"budget_ms": 0}, "budget_ms must be"),
        ({"disparity_range": (2, 1)}, "disparity range"),
    ],
)
def test_wrong_arguments(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(lfgpu.LightFieldError, match=sentence):
        made(**options)


@pytest.mark.parametrize("options", [{"persistence": 1.0}, {"strength": -1}, {"reach": "far"}, {"tolerance": True}])
def test_wrong_priors(options: dict[str, Any]) -> None:
    with pytest.raises(lfgpu.LightFieldError, match=next(iter(options))):
        lfgpu.TemporalPrior(**options)


def test_the_page_of_streams_names_what_is_there() -> None:
    section = (Path(__file__).parents[1] / "docs" / "streams.md").read_text(encoding="utf-8")
    for prefix, home in (
        ("stream", lfgpu.DepthStream),
        ("result", lfgpu.StreamResult(0, None, np.ones(1, bool))),
        ("DepthStream", lfgpu.DepthStream),
    ):
        names = re.findall(rf"(?<!\w){prefix}\.(\w+)", section)
        assert names
        assert set(names) <= set(dir(home)), names

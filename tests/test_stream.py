"""A stream gives each frame the map that a pipeline gives, keeps its results apart, and says what it did."""

import gc
import re
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stream_runs import FRAMES, LONG, RANGE, adds_up, alone, frames, made, other_scene, until

import lfgpu
from lfgpu import scenes
from tests.made import masked, thorough


@pytest.mark.parametrize("config", ["accurate", "fast"])
def test_without_a_prior_each_map_is_that_of_a_pipeline(config: str) -> None:
    with made(config=config, prior=None) as stream:
        results = [stream.push(lf.views) for lf in frames()[:2]]
        for index, result in enumerate(results):
            np.testing.assert_array_equal(result.numpy(), alone(config, index))
            assert (result.index, result.cold, result.cut) == (index, True, False)


def test_first_map_is_that_of_estimate_depth() -> None:
    want = lfgpu.estimate_depth(frames()[0], config="fast", device="cpu")
    with made(config="fast", disparity_range=None) as stream:
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


@pytest.mark.parametrize("config", ["accurate", thorough("fast")])
@pytest.mark.parametrize("seed", [0, *map(thorough, (1, 2))])
def test_the_past_is_not_believed_where_the_reference_view_shows_something_else(seed: int, config: str) -> None:
    """Half of the views is of another scene in the last frame: there its map is as right as one of this frame alone.

    Were the past believed, 65 to 76 % would be wrong there; did its surfaces hide anything, 26 to 40 %, not 12 to 17.
    """
    options: dict[str, Any] = {"grid": (3, 5), "size": (64, 72)}
    before, after = scenes.make("planes", seed=seed, **options), scenes.make("boxes", seed=seed + 10, **options)
    assert after.truth is not None
    changed = before.views.copy()
    changed[:, :, 36:] = after.views[:, :, 36:]

    def wrong(result: lfgpu.StreamResult) -> float:
        error = np.abs(result.numpy() - after.truth.disparity)[8:-8, 44:-6]  # type: ignore[union-attr]
        return float((error > 0.07).mean())

    with made(before, config=config, disparity_range=(-1.6, 1.7)) as stream:
        for _ in range(6):
            stream.push(before.views).wait()
        warm = stream.push(changed)
        warm.wait()
        stream.restart()
        cold = stream.push(changed)
        assert (warm.cut, warm.cold, cold.cold) == (False, False, True)
        assert wrong(warm) < wrong(cold) + 0.03


def test_a_cut_or_a_restart_forgets() -> None:
    """And so the frame after it has the map that it has alone."""
    with made() as stream:
        first, cut = stream.push(other_scene().views), stream.push(frames()[1].views)
        np.testing.assert_array_equal(cut.numpy(), alone("fast", 1))
        assert (first.cut, cut.cut, cut.cold) == (False, True, True)
        assert stream.stats()["scene_cuts"] == 1
    with made() as stream:
        stream.push(frames()[0].views).wait()
        stream.restart()
        np.testing.assert_array_equal(stream.push(frames()[1].views).numpy(), alone("fast", 1))


def test_cameras_of_a_large_grid_drop_out_and_come_back() -> None:
    """Without them the map is that of views that are masked. Every other one is swept at first: masks go with them."""
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
        assert np.array_equal(stream.push(lf.views).numpy(), whole)
        assert stream.stats()["frames_with_missing_views"] == 1
    assert not np.array_equal(want, whole)
    with made(lf, config=config) as stream:
        stream.push(lf.views).wait()
        warm = stream.push(lf.views).numpy()
    assert np.median(np.abs(warm - whole)) < 0.01


def test_masks_of_the_light_field_stay() -> None:
    lf = frames()[0]
    known = masked(lf, np.s_[:, :6, :9])
    want = lfgpu.estimate_depth(known, config="fast", disparity_range=RANGE, device="cpu").disparity
    there = np.ones(15, bool)
    there[5] = False
    with made(known, prior=None) as stream:
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)
        assert not np.array_equal(stream.push(lf.views, valid=there).numpy(), want, equal_nan=True)
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)


def test_what_the_reference_did_not_record_is_unknown_in_warm_maps_too() -> None:
    """Although the past holds numbers there, for the sums of neighbours."""
    lf = frames()[0]
    known = masked(lf, np.s_[7, 10:22, 12:30])
    there = known.valid[7]
    with made(known) as stream:
        results = [stream.push(frame.views) for frame in frames()]
        maps = [result.numpy() for result in results]
        trust = [result.confidence() for result in results]
    assert [result.cold for result in results] == [True] + [False] * (FRAMES - 1)
    for disparity, confidence in zip(maps, trust, strict=True):
        np.testing.assert_array_equal(np.isnan(disparity), ~there)
        assert (confidence[~there] == 0).all()
    beside = np.zeros_like(there)
    beside[9:23, 11:31] = True
    beside &= there
    assert (maps[-1][beside] > RANGE[0] + 0.01).all()


def test_before_there_is_a_frame() -> None:
    lf = frames()[0]
    config = lfgpu.PRESETS["fast"].with_values({"sweep.noise": 0.01})
    want = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").disparity
    with lfgpu.DepthStream.for_cameras(
        lf.positions, lf.size, disparity_range=RANGE, noise=0.01, config="fast", device="cpu", reference=lf.reference
    ) as stream:
        np.testing.assert_array_equal(stream.push(lf.views).numpy(), want)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"size": (48,)}, r"size must be \(height, width\), whole numbers from 1 on, not \(48,\)"),
        ({"size": (48, -1)}, "size must be"),
        ({"size": "48x56"}, "size must be"),
        ({"channels": -1}, "channels must be"),
        ({"noise": -1}, "noise must be a number from 0 to 1, not -1"),
        ({"noise": "0.1"}, "noise must be"),
        ({"positions": 3}, "views must be"),
        ({"positions": "x"}, "positions must be an array of numbers"),
    ],
)
def test_cameras_that_are_none(wrong: dict[str, Any], sentence: str) -> None:
    given = {"positions": [[0, 0], [1, 0]], "size": (48, 56), "disparity_range": RANGE, "config": "fast"} | wrong
    with pytest.raises(lfgpu.LightFieldError, match=sentence):
        lfgpu.DepthStream.for_cameras(**given)


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
        for _ in range(before + 2):
            stream.push(frames()[0].views).wait()
        assert stream.stats()["result_buffers"] == held_up


def test_a_closed_stream_returns_its_memory_and_results_keep_theirs() -> None:
    stream = made()
    result = stream.push(frames()[0].views)
    want = result.numpy()
    parts = [weakref.ref(part) for part in (stream._engine._plan, stream._engine.transport, stream._engine._front)]
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
            patch.setattr(stream._engine.transport, "solve", lambda *_: 1 / 0)
            failed = [stream.push(lf.views) for lf in frames()[:2]]
            assert all(result.wait(LONG) for result in failed)
        np.testing.assert_array_equal(stream.push(frames()[0].views).numpy(), alone("fast", 0))
    assert [str(result.error) for result in failed] == ["the device failed (division by zero)."] * 2
    assert caplog.text.count("Traceback") == 1


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


@pytest.mark.parametrize("ending", [thorough(SystemExit), KeyboardInterrupt])
def test_a_callback_that_ends_its_thread_does_not_end_the_stream(ending: type[BaseException]) -> None:
    def leave(_: lfgpu.StreamResult) -> None:
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


# --- numbers ---


def test_budget_picks_the_work() -> None:
    """As much as fits by what it took; times are set, as those of this machine are not known."""
    config = lfgpu.PRESETS["accurate"].with_values({"alignment.iterations": 3})
    with made(config=config, budget_ms=10.0) as stream:
        for level in stream._engine._cold:
            level.seconds = 1.0
        for steps, level in enumerate(stream._engine._warm, 1):
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


def test_stats() -> None:
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
        assert stats["frames_done"] == FRAMES


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"config": "paper"}, "synthesis cannot"),
        ({"config": 3}, "config must be"),
        ({"policy": "newest"}, "policy must be one of latest, block, queue"),
        ({"policy": "latest", "waiting": 2}, "waiting must be"),
        ({"waiting": 0}, "waiting must be"),
        ({"policy": "queue", "waiting": "x"}, "waiting must be"),
        ({"policy": "queue", "waiting": 10**9}, "waiting must be"),
        ({"cut": 2.0}, "cut must be"),
        ({"prior": True}, "prior must be a TemporalPrior or None, not True"),
        ({"budget_ms": "x"}, "budget_ms must be"),
        ({"budget_ms": 0}, "budget_ms must be"),
        ({"disparity_range": (2, 1)}, "disparity range"),
    ],
)
def test_wrong_arguments(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(lfgpu.LightFieldError, match=sentence):
        made(**options)


def test_a_result_is_no_light_field() -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(24, 32))
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    with pytest.raises(lfgpu.LightFieldError, match="lf must be a LightField, found DepthResult"):
        lfgpu.DepthStream(result)  # type: ignore[arg-type]


def test_wrong_priors() -> None:
    wrong: dict[str, Any] = {"persistence": 1.0, "strength": -1, "reach": "far", "tolerance": True}
    for name, value in wrong.items():
        with pytest.raises(lfgpu.LightFieldError, match=name):
            lfgpu.TemporalPrior(**{name: value})


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

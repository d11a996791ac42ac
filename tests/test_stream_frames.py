"""Frames of all kinds, and the sentences about them: wrong ones fail alone, ranges and stamps that do not fit too."""

import re
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stream_runs import FRAMES, LONG, alone, frames, held, made

import lfgpu
from lfgpu import scenes
from lfgpu.pipelines.intake import Intake
from lfgpu.pipelines.watches import RangeWatch
from lfgpu.threads import get_threads, limited_threads
from tests.made import Tensor


def test_forms_of_a_frame() -> None:
    views = frames()[0].views
    strided = np.repeat(views, 2, axis=2)[:, :, ::2]
    assert not strided.flags.c_contiguous
    with made(prior=None) as stream:
        want = stream.push(views).numpy()
        for form in (strided, views.reshape(3, 5, *views.shape[1:]), Tensor(views)):
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
        (np.ma.masked_less(views, 100), None, "only a LightField takes masks"),
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


@pytest.mark.parametrize("looks", [True, False], ids=["host", "device"])
def test_float_frames_in_another_unit_are_refused(looks: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also frames that lie on a GPU, which the host does not look at: the device sees it as well."""
    lf = scenes.make("planes", grid=(3, 3), size=(32, 32), dtype=np.float32, disparity_range=(-1, 1))
    if not looks:
        monkeypatch.setattr("lfgpu.pipelines.intake.check_scaled", lambda *_: None)
    words = r"view \d has values from .* scale float views to \[0, 1\]" if looks else "scale float views"
    with made(lf, disparity_range=(-1, 1)) as stream:
        with pytest.raises(lfgpu.LightFieldError, match=words):
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


@pytest.mark.parametrize(("near", "frames_at_it"), [(0.5, 0), (0.2, 1)])
def test_a_range_that_lacks_what_has_no_texture_is_said_so(near: float, frames_at_it: int) -> None:
    """Also where its map does not show that: where a disparity that is compared lies on an end, hardly a pixel does."""
    lf = scenes.make("textureless", grid=(5, 5), size=(96, 96), seed=1, noise=0.005, disparity_range=(-1, 1))
    with made(lf, disparity_range=(-1.1, near)) as stream:
        assert stream.push(lf.views).wait(LONG)
    assert stream.stats()["frames_beyond_range"] == frames_at_it
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
    assert results[1].stamps[5] == 7.02 + 0.001 * 5 / 15  # a copy: what became of `late` since is no matter
    assert results[3].stamps is None
    assert results[4].stamps is not None
    assert np.isnan(results[4].stamps).tolist() == (~missing).tolist()
    assert stream.stats()["frames_out_of_step"] == 2


def test_wrong_stamps_fail_their_frame_only() -> None:
    wrong: list[tuple[Any, str]] = [
        (np.zeros(14), r"stamps must be \[15\], one for each view; found \[14\]"),
        (["noon"] * 15, "stamps must be numbers of seconds"),
        ([0.0] * 14 + [float("nan")], r"the stamp of view 14 is nan; give seconds, or set valid\[14\] to False"),
    ]
    with made(tolerance=0.004) as stream:
        results = [stream.push(frames()[0].views, stamps=stamps) for stamps, _ in wrong]
        right = stream.push(frames()[0].views, stamps=np.zeros(15))
        assert right.wait(LONG)
    assert right.error is None
    for result, (_, words) in zip(results, wrong, strict=True):
        assert re.search(words, str(result.error))


def test_a_tolerance_is_a_number_of_seconds() -> None:
    wrong: list[Any] = [0, -1.0, float("nan"), True, "4 ms"]
    for tolerance in wrong:
        with pytest.raises(lfgpu.LightFieldError, match="tolerance must be a number of seconds > 0"):
            made(tolerance=tolerance)


def test_a_search_for_the_range_keeps_to_its_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other threads, which copy frames, are as many as before."""
    seen: list[int] = []

    def found(*_: Any) -> tuple[float, float]:
        seen.append(get_threads())
        with ThreadPoolExecutor(1) as other:
            seen.append(other.submit(get_threads).result())
        return -2.0, 2.0

    monkeypatch.setattr("lfgpu.pipelines.watches.find_disparity_range", found)
    with limited_threads(3):
        RangeWatch((-2.0, 2.0)).search(frames()[0], "the first views")
        assert seen == [1, 3]
        assert get_threads() == 3


@pytest.mark.parametrize("valid", [True, False], ids=["all", "but-one"])
def test_views_are_sent_while_others_are_copied(valid: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each view once, when it is there; a part that is not whole is not sent."""
    monkeypatch.setattr("lfgpu.pipelines.intake._AT_ONCE", 1)
    lf, sent, there = frames()[0], [], np.ones(15, bool)
    there[3] = valid
    slot = SimpleNamespace(host=np.full_like(lf.views, 7), present=np.zeros(15, np.float32))
    want = lf.views.copy()
    want[~there] = 0

    def send(_: Any, first: int, last: int) -> None:
        assert np.array_equal(slot.host[first:last], want[first:last])
        sent.extend(range(first, last))

    with limited_threads(4):
        intake = Intake(lf, range(15), "cpu")
    intake.fill(slot, lf.views, there, SimpleNamespace(enter=lambda: None, send=send), on_gpu=False)  # type: ignore[arg-type]
    intake.close()
    assert sent == list(range(15))

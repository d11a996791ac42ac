"""Compiling and loading kernels is timed by itself: stages take what they take."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from lfgpu.kernels.warp import threads

from lfgpu import scenes
from lfgpu._backends import load, open_device
from lfgpu.data.lightfield import LightField
from lfgpu.methods import method_of
from lfgpu.methods.base import Work
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.pipelines import pipeline, rehearsal
from lfgpu.pipelines.estimate import estimate_depth

COMPILING, WORKING = 100.0, 1.0
RANGE = (-2.0, 2.0)


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The stages that were compiled, as if nothing were yet: on a clock that only compiling and working move on."""
    seconds, done, stages = [0.0], set[str](), MatchingPlan.stages
    monkeypatch.setattr(rehearsal, "_known", set())
    monkeypatch.setattr(pipeline, "perf_counter", lambda: seconds[0])

    def timed(name: str, work: Work) -> Work:
        def run(callback: Callable[[int, float], None] | None) -> None:
            seconds[0] += WORKING + (0.0 if name in done else COMPILING)
            done.add(name)
            work(callback)

        return run

    def slow(self: MatchingPlan, views: Any) -> dict[str, Work]:
        return {name: timed(name, work) for name, work in stages(self, views).items()}

    monkeypatch.setattr(MatchingPlan, "stages", slow)
    return done


def a_light_field() -> LightField:
    return scenes.make("relief", grid=(3, 3), size=(40, 48))


def test_the_first_stage_is_not_charged_with_compiling(compiled: set[str]) -> None:
    lf = a_light_field()
    first = estimate_depth(lf, config="fast", disparity_range=RANGE).timings
    stages = [stage.name for stage in method_of("fast").stages]
    assert compiled == set(stages)
    assert list(first) == ["compile", "measure", *stages, "total"]
    assert {first[stage] for stage in stages} == {WORKING}
    assert first["compile"] == len(stages) * (COMPILING + WORKING)
    assert first["total"] == first["compile"] + first["measure"] + len(stages) * WORKING
    again = estimate_depth(lf, config="fast", disparity_range=RANGE).timings
    assert again["compile"] == 0
    assert again["total"] == len(stages) * WORKING


def test_what_came_before_the_first_run_is_no_part_of_the_second(compiled: set[str]) -> None:
    made = pipeline.DepthPipeline(a_light_field(), config="fast", disparity_range=RANGE)
    assert made.estimate().timings["compile"] > 0
    again = made.estimate().timings
    assert list(again) == [*(stage.name for stage in method_of("fast").stages), "total"]
    assert again["total"] == (len(again) - 1) * WORKING


def test_nothing_is_rehearsed_where_nothing_is_compiled(compiled: set[str]) -> None:
    assert not load("reference").compiles
    timings = estimate_depth(a_light_field(), config="fast", disparity_range=RANGE, backend="reference").timings
    assert timings["compile"] == 0


def test_a_rehearsal_leaves_no_trace_in_the_map() -> None:
    lf = a_light_field()
    maps = []
    for known in (False, True):
        if not known:
            rehearsal._known.clear()
        maps.append(estimate_depth(lf, config="accurate", disparity_range=RANGE, device="cpu").disparity)
    np.testing.assert_array_equal(*maps)


def test_a_rehearsal_loads_all_kernels_at_once_and_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    loads: list[str] = []
    from_cache = threads.from_cache

    def watched(start: Callable[[], object], module: Any, *where: Any) -> None:
        if not threads.is_preparing():
            loads.append(threading.current_thread().name)
        from_cache(start, module, *where)

    monkeypatch.setattr(threads, "_loaded", set())
    monkeypatch.setattr(rehearsal, "_known", set())
    lf, place = a_light_field(), open_device(device="cpu")
    made = pipeline.DepthPipeline(lf, config="fast", disparity_range=RANGE, device="cpu")
    loaded = set(threads._loaded)
    made.estimate()
    assert threads._loaded == loaded
    monkeypatch.setattr(threads, "_loaded", set())
    monkeypatch.setattr(threads, "from_cache", watched)
    rehearsal._known.clear()
    rehearsal.Rehearsal(made.method, lf, place).run(made.measured)
    assert len(loads) == len(threads._loaded) > 20
    assert all(name.startswith("lfgpu-compiling") for name in loads)


def test_prepared_work_is_still_to_be_done(target: Any) -> None:
    kernels, device = target.kernels, target.device
    field, calls = kernels.zeros((4, 5), device), []
    go_on = kernels.scalar(1.0, device)

    def work() -> None:
        calls.append(1)
        kernels.fill(3.0, field)
        kernels.repeat(lambda: kernels.axpby(1.0, go_on, -1.0, go_on, go_on), go_on, 2)

    kernels.prepare(work, device)
    assert calls == [1]
    kernels.upload(np.zeros((4, 5), np.float32), field)
    kernels.fill(3.0, field)
    np.testing.assert_array_equal(kernels.numpy(field), 3.0)


def test_views_without_anything_in_their_middle_can_be_estimated(compiled: set[str]) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(96, 96))
    views = lf.views.copy()
    views[:, 30:66, 30:66] = 0
    valid = np.ones(views.shape[:3], np.bool_)
    valid[:, 30:66, 30:66] = False
    result = estimate_depth(replace(lf, views=views, valid=valid, truth=None), config="fast")
    assert result.timings["compile"] > 0

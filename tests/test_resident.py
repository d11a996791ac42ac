"""Pipelines that stay in memory: the next estimate of the kind is that of a pipeline of its own, bit for bit."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfgpu
from benchmarks import call
from lfgpu import scenes
from lfgpu._backends import load, open_device
from lfgpu.cameras import points
from lfgpu.contract import Device, memory, take_host_memory
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods import disparity_range, method_of
from lfgpu.methods.matching import frame, noise
from lfgpu.methods.matching.disparities import padded_disparities
from lfgpu.pipelines import pipeline as pipeline_module
from lfgpu.pipelines.pipeline import DepthPipeline
from lfgpu.pipelines.resident import KEPT, _return_memory, kept_memory, set_kept_memory
from tests.made import masked as with_masks, thorough

LIMIT = "2GiB"


@pytest.fixture(autouse=True)
def _limit() -> Iterator[None]:
    yield
    set_kept_memory(LIMIT)


def a_scene(seed: int, noise: float = 0.0, *, masked: bool = False) -> LightField:
    """Make a light field of one kind, whose range, noise and grain depend on `seed` and `noise`."""
    lf = replace(scenes.make("relief", grid=(3, 5), size=(48, 56), seed=seed, noise=noise), truth=None)
    return with_masks(lf, np.s_[2, 10:20, 5:20], np.s_[lf.reference_index, :3, :4]) if masked else lf


FIELDS = (0, 0.0), (1, 0.02), (2, 0.0), (2, 0.0)
"""Seeds and noises; the last two light fields are the same, which a GPU repeats as a graph."""
GIVEN = (-2.5, 2.5)


def estimated(lf: LightField, target: Any, **options: Any) -> DepthResult:
    return lfgpu.estimate_depth(lf, backend=target.backend, device=target.device, check_cameras=False, **options)


def assert_equal(one: DepthResult, other: DepthResult) -> None:
    for name in ("disparity", "confidence", "uncertainty"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for stage, map_ in one.stages.items():
        np.testing.assert_array_equal(map_, other.stages[stage])
    for name in ("disparity_range", "status", "trace", "converged", "notes", "name", "config"):
        assert getattr(one, name) == getattr(other, name)


@pytest.mark.parametrize(
    ("config", "given", "masked"),
    [
        ("fast", GIVEN, True),
        ("surest", None, True),  # which has the parts of accurate and learned
        ("paper", None, False),
        *(
            thorough(*case)
            for case in (
                ("accurate", None, True),
                ("accurate", GIVEN, False),
                ("learned", None, False),
                ("paper", GIVEN, True),
            )
        ),
    ],
)
def test_results_do_not_depend_on_light_fields_before(target: Any, config: str, given: Any, masked: bool) -> None:
    if not target.kernels.is_deterministic(target.device):
        pytest.skip("its maps differ from run to run")
    if target.backend != "warp" and (masked or config in ("learned", "surest", "paper")):
        pytest.skip("takes long, and is the same on the host")
    fields = [a_scene(seed, noise, masked=masked) for seed, noise in FIELDS]
    alone = []
    for lf in fields[:3]:
        KEPT.free()
        alone.append(estimated(lf, target, config=config, disparity_range=given))
    alone.append(alone[2])
    assert len({result.disparity_range for result in alone}) == (3 if given is None else 1)
    KEPT.free()
    for lf, result in zip(fields, alone, strict=True):
        assert_equal(estimated(lf, target, config=config, disparity_range=given), result)
        assert len(KEPT._kept) == 1


@pytest.mark.parametrize("config", ["fast", thorough("accurate"), "surest"])
def test_light_fields_of_a_kind_share_plan_and_graph(config: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their ranges, numbers of disparities, noises and penalties differ; a capture is faked, as a CPU has none."""
    fields = [a_scene(seed, noise) for seed, noise in ((0, 0.02), (1, 0.01), (2, 0.005))]
    made: list[str] = []
    replan, kernels = DepthPipeline._replan, load()
    monkeypatch.setattr(DepthPipeline, "_replan", lambda *given: (made.append("plan"), replan(*given)))
    monkeypatch.setattr(kernels, "capture", lambda work, device: (made.append("graph"), work)[1])
    monkeypatch.setattr(Device, "is_gpu", property(lambda device: True))  # so that all stages run as one graph
    monkeypatch.setitem(frame._ROOM, "gpu", 1)
    alone = []
    for lf in fields:
        KEPT.free()
        alone.append(lfgpu.estimate_depth(lf, config=config, device="cpu", check_cameras=False))
    ranges = [result.disparity_range for result in alone]
    assert len(set(ranges)) == len({result.status for result in alone}) == len(fields)
    assert len({round(high - low, 1) for low, high in ranges}) > 1
    KEPT.free()
    made.clear()
    monkeypatch.setitem(frame._ROOM, "gpu", 64)
    for lf, result in zip((fields[0], *fields), (alone[0], *alone), strict=True):
        assert_equal(lfgpu.estimate_depth(lf, config=config, device="cpu", check_cameras=False), result)
    counts = [0]  # the volumes of a network hold all disparities that it compares, and no others
    if config == "surest":
        counts = [padded_disparities(bounds, fields[0].layout.farthest).count for bounds in ranges]
    assert made == ["plan", "graph"] * (1 + np.count_nonzero(np.diff(counts)))


@pytest.mark.parametrize("check", [True, False])
def test_windows_are_ranked_once_while_a_gpu_works(check: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    def tell(home: Any, name: str) -> None:
        function = getattr(home, name)
        monkeypatch.setattr(home, name, lambda *given, **options: (said.append(name), function(*given, **options))[1])

    lf = a_scene(0)
    alone = lfgpu.estimate_depth(lf, config="fast", device="cpu", check_cameras=check)
    monkeypatch.setattr(Device, "is_gpu", property(lambda device: True))
    for home, name in ((DepthPipeline, "work"), (points, "_ranked"), (load(), "number"), (load(), "numpy")):
        tell(home, name)
    assert_equal(lfgpu.estimate_depth(replace(lf), config="fast", device="cpu", check_cameras=check), alone)
    assert said.count("_ranked") == check
    begun = said.index("work")
    assert said[begun : begun + 3] == (["work", "_ranked", "number"] if check else ["work", "number", "numpy"])


@pytest.mark.parametrize("config", ["fast", "accurate"])
def test_memory_of_a_result_is_taken_while_a_gpu_works(config: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels, blocks = load(), list[Any]()
    copied = kernels.numpy

    def take(size: int, count: int) -> None:
        take_host_memory(size, count)
        blocks.extend(memory._here.taken)

    def read(array: Any) -> Any:
        values = memory.host_memory(array.shape, np.float32)
        values[...] = copied(array)
        return values

    lf = a_scene(0)
    alone = lfgpu.estimate_depth(lf, config=config, device="cpu", check_cameras=False)
    KEPT.free()
    monkeypatch.setattr(Device, "is_gpu", property(lambda device: True))
    monkeypatch.setattr(pipeline_module, "take_host_memory", take)
    monkeypatch.setattr(kernels, "numpy", read)
    found = lfgpu.estimate_depth(lf, config=config, device="cpu", check_cameras=False)
    KEPT.free()
    assert_equal(found, alone)
    maps = [found.disparity, found.confidence, found.uncertainty, *found.stages.values()]
    used = sum(any(np.shares_memory(block, map_) for map_ in maps) for block in blocks)
    assert used == len(maps) == len(blocks) - 1  # the range was confirmed by one more
    assert memory._here.taken == []


@pytest.mark.parametrize("config", ["fast", "accurate"])
def test_what_is_measured_again_needs_no_memory(config: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU; and what stays of a light field leaves no trace in what is measured in the next one."""
    fields = [a_scene(seed, noise) for seed, noise in ((0, 0.02), (1, 0.01), (2, 0.005), (0, 0.02))]
    want = [method_of(config).measure(lf, open_device(device="cpu")) for lf in fields]
    monkeypatch.setattr(Device, "is_gpu", property(lambda device: True))
    monkeypatch.setitem(frame._ROOM, "gpu", 64)
    planned: list[str] = []

    def told(make: Any, *given: Any, **options: Any) -> Any:
        planned.append(make.__name__)
        return make(*given, **options)

    for home, name in ((noise, "_FirstSweep"), (disparity_range, "_Comparison")):
        monkeypatch.setattr(home, name, partial(told, getattr(home, name)))
    pipeline = DepthPipeline(fields[0], config=config, device="cpu")
    planned.clear()
    for lf, measured in zip(fields, want, strict=True):
        pipeline.take(lf)
        assert pipeline.measured == measured
    assert len({measured.disparity_range for measured in want}) == 3
    assert not planned  # all of them fit into what was planned for the first
    for name in ("zeros", "zeros_image", "field", "image", "scalar"):
        monkeypatch.setattr(load(), name, None)
    pipeline.take(replace(fields[3]))


def test_a_pipeline_takes_no_light_field_of_another_kind() -> None:
    """Whose first views it would take for those of its own cameras."""
    lf = a_scene(0)
    more = replace(scenes.make("relief", grid=(5, 5), size=(48, 56)), truth=None)
    stretched = replace(lf, positions=lf.positions * 2, grid_shape=None)
    pipeline = DepthPipeline(lf, config="fast", device="cpu", disparity_range=GIVEN)
    want = pipeline.estimate().disparity
    for other in (more, stretched, lf.with_reference(0), a_scene(0, masked=True), lf.crop(slice(40), slice(40))):
        with pytest.raises(LightFieldError, match=r"another kind.*make a pipeline for it\.$"):
            pipeline.take(other, disparity_range=GIVEN)
    with pytest.raises(LightFieldError, match="lf must be a LightField"):
        pipeline.take(lf.views)  # type: ignore[arg-type]
    pipeline.upload(lf.views)
    pipeline.run()
    np.testing.assert_array_equal(pipeline.disparity(), want)
    masked = a_scene(0, masked=True)
    of_masked = DepthPipeline(masked, config="fast", device="cpu", disparity_range=GIVEN)
    of_masked.take(a_scene(1, masked=True), disparity_range=GIVEN)
    with pytest.raises(LightFieldError, match="masks"):
        of_masked.take(replace(masked, valid=~masked.valid), disparity_range=GIVEN)


def test_light_fields_of_other_kinds_have_pipelines_of_their_own() -> None:
    first = a_scene(0)
    kinds = [
        first,
        first.with_reference(0),
        first.crop(slice(0, 40), slice(0, 40)),
        a_scene(0, masked=True),
        replace(first, views=first.views.astype(np.uint16) * 257, white=None),
    ]
    for count, lf in enumerate(kinds, 1):
        lfgpu.estimate_depth(lf, config="fast", device="cpu", disparity_range=(-2, 2), check_cameras=False)
        assert len(KEPT._kept) == min(count, 4)  # the most that are kept
    lfgpu.estimate_depth(first, config="accurate", device="cpu", disparity_range=(-2, 2), check_cameras=False)
    assert next(reversed(KEPT._kept.values()))[0].config != next(iter(KEPT._kept.values()))[0].config


def test_memory_is_limited_counted_and_freed() -> None:
    lf = a_scene(0)
    estimate = lambda: lfgpu.estimate_depth(lf, config="fast", device="cpu", disparity_range=(-2, 2))  # noqa: E731
    estimate()
    kept = lfgpu.kept_memory()
    assert kept > 10 * lf.views[lf.reference_index].nbytes
    lfgpu.set_kept_memory(0)
    assert lfgpu.kept_memory() == 0
    for limit in (0, kept - 1, kept):
        lfgpu.set_kept_memory(limit)
        estimate()
        assert lfgpu.kept_memory() == (kept if limit == kept else 0)
    lfgpu.estimate_depth(lf, config="fast", device="cpu", disparity_range=(-2, 2), max_memory="2GiB")
    assert lfgpu.kept_memory() == 0  # the limit is for all that the process has
    with pytest.raises(LightFieldError, match="must be a size such as 8GiB"):
        lfgpu.set_kept_memory("much")


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="the system's count of memory is read from /proc")
@pytest.mark.parametrize("limit", ["2GiB", 0], ids=["kinds", "nothing kept"])
def test_memory_of_dropped_pipelines_returns_to_the_system(limit: str | float) -> None:
    """Pipelines of many kinds, one after the other, take no more than those that are kept."""
    KEPT.free()
    _return_memory()  # what other tests left
    set_kept_memory(limit)
    lf = scenes.make("boxes", grid=(5, 5), size=(160, 160))
    used = []
    for cut in range(8):
        small = replace(lf, views=lf.views[:, : 160 - 2 * cut], truth=None)
        lfgpu.estimate_depth(small, config="learned", disparity_range=(-2, 2), check_cameras=False)
        used.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 - kept_memory())
    assert max(used[2:]) < min(used[2:]) + 100e6  # a pipeline takes as much, and six are dropped at least


def test_a_light_field_without_an_estimate_leaves_no_trace() -> None:
    lf = a_scene(0)
    want = lfgpu.estimate_depth(lf, config="fast", device="cpu")
    blank = replace(lf, views=np.full_like(lf.views, 128))
    for given in (None, (-2.0, 2.0), (1.0, 1.0)):
        with pytest.raises(LightFieldError):
            lfgpu.estimate_depth(blank, config="fast", device="cpu", disparity_range=given)
        assert_equal(lfgpu.estimate_depth(lf, config="fast", device="cpu"), want)
        assert len(KEPT._kept) == 1


def test_threads_do_not_share_a_pipeline() -> None:
    fields = [a_scene(seed) for seed in range(4)]
    want = [lfgpu.estimate_depth(lf, config="fast", device="cpu") for lf in fields]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            found = pool.map(lambda lf: lfgpu.estimate_depth(lf, config="fast", device="cpu"), fields)
            for one, other in zip(found, want, strict=True):
                assert_equal(one, other)


def test_a_pipeline_takes_another_light_field() -> None:
    """Also after one whose range was widened, or whose stages were followed one by one."""
    first, second = a_scene(0), a_scene(1, 0.02)
    pipeline = DepthPipeline(first, config="fast", device="cpu")
    pipeline.estimate(on_progress=lambda *_: None)
    pipeline.take(second)
    assert_equal(pipeline.estimate(), DepthPipeline(second, config="fast", device="cpu").estimate())
    pipeline.take(first, measured=pipeline.measured)
    measured = DepthPipeline(first, config="fast", device="cpu", measured=pipeline.measured)
    assert_equal(pipeline.estimate(), measured.estimate())


@pytest.mark.parametrize("seed", [0, 2])
def test_stages_at_once_are_those_one_by_one(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """As on a GPU, which is not waited for after each of them; one of the ranges is widened."""
    lf = a_scene(seed)
    found = DepthPipeline(lf, config="fast", device="cpu").measured.disparity_range
    narrow = (found[0], found[0] + 0.6 * (found[1] - found[0]))
    if seed:
        monkeypatch.setattr("lfgpu.methods.base.find_disparity_range", lambda *_, **__: narrow)
    want = DepthPipeline(lf, config="fast", device="cpu").estimate()
    assert bool(seed) == (want.disparity_range not in (found, narrow))
    monkeypatch.setattr("lfgpu.contract.Device.is_gpu", property(lambda _: True))
    pipeline = DepthPipeline(lf, config="fast", device="cpu")
    assert_equal(pipeline.estimate(), want)
    again = pipeline.estimate()
    assert_equal(again, want)
    assert again.timings.keys() == {"run", "total"}


@pytest.mark.thorough
def test_the_benchmark_of_calls_compares_maps_and_times_parts() -> None:
    rows = list(call.run(["fast"], "cpu", side=48, views=3))
    assert [row["call"] for row in rows] == ["first", "second", "in turn"]
    assert all(row["same map"] for row in rows)
    assert ["take" in row for row in rows] == [False, True, True]
    assert ["numbers" in row for row in rows] == [False, False, True]
    assert ["plan" in row for row in rows] == [True, False, False]
    assert len(call.table(rows).rows) == len(rows)

"""One pipeline for many light fields of one kind: each map is that of a pipeline made for those views alone."""

import gc
import re
import weakref
from functools import cache
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.config import Config
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.methods import configured
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.pipelines.pipeline import DepthPipeline
from tests.made import masked, thorough

RANGE = (-1.5, 1.5)
CONFIG = SynthesisConfig().with_values({"prior.window": 5, "refinement.max_iterations": 8})
SAME = 1e-3  # pixels per view step, 95 % quantile: sums are in an order that a GPU decides


@cache
def scene(seed: int = 0, *, damaged: bool = False) -> LightField:
    lf = scenes.make("relief", grid=(3, 5), size=(32, 36), seed=seed)
    if not damaged:
        return lf
    some = lf.subset([index for index in range(len(lf.views)) if index not in (0, 9)])
    return masked(some, np.s_[2, 10:20, 5:20], np.s_[some.reference_index, :3, :4])


def made(lf: LightField, target: Any, config: Config = CONFIG) -> DepthPipeline:
    return DepthPipeline(lf, config=config, disparity_range=RANGE, backend=target.backend, device=target.device)


def ran(pipeline: DepthPipeline, views: np.ndarray | None = None) -> np.ndarray:
    """The map of one more run."""
    if views is not None:
        pipeline.upload(views)
    pipeline.run()
    return pipeline.disparity()


def assert_same(one: np.ndarray, other: np.ndarray, target: Any) -> None:
    """Bit for bit where the backend promises that."""
    assert one.dtype == other.dtype == np.float32
    assert one.shape == other.shape
    if target.kernels.is_deterministic(target.device):
        np.testing.assert_array_equal(one, other)
    else:
        np.testing.assert_array_equal(np.isnan(one), np.isnan(other))
        assert np.nanquantile(np.abs(one - other), 0.95) <= SAME


WHOLE_OR_DAMAGED = [thorough(False, id="whole"), pytest.param(True, id="damaged")]


@pytest.mark.parametrize("damaged", WHOLE_OR_DAMAGED)
def test_runs_again_give_the_same_map(target: Any, damaged: bool) -> None:
    """On a GPU the second and third are captured ones."""
    pipeline = made(scene(damaged=damaged), target)
    first, second, third = (ran(pipeline) for _ in range(3))
    assert_same(second, first, target)
    assert_same(third, first, target)


@pytest.mark.parametrize("config", ["fast", CONFIG], ids=["matching", "synthesis"])
def test_a_result_copies_each_map_once(config: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = DepthPipeline(scene(damaged=True), config=configured(config), disparity_range=RANGE, device="cpu")
    disparity, copied, kernels = ran(pipeline), list[object](), pipeline.kernels
    numpy, read, final = kernels.numpy, kernels.read, pipeline._plan.disparity
    monkeypatch.setattr(kernels, "numpy", lambda field: (copied.append(field), numpy(field))[1])
    monkeypatch.setattr(kernels, "read", lambda field, *more: (copied.append(field), read(field, *more))[1])
    result = pipeline.result()
    assert sum(field is final for field in copied) == 1
    np.testing.assert_array_equal(result.disparity, disparity)
    last = list(result.stages.values())[-1]
    np.testing.assert_array_equal(last, disparity)
    assert not np.shares_memory(last, result.disparity)


@pytest.mark.parametrize("damaged", WHOLE_OR_DAMAGED)
def test_other_views_give_what_a_fresh_pipeline_gives(target: Any, damaged: bool) -> None:
    fields = [scene(seed, damaged=damaged) for seed in range(3)]
    pipeline = made(fields[0], target)
    pipeline.run()
    for lf in fields[1:]:
        assert_same(ran(pipeline, lf.views), ran(made(lf, target)), target)
    assert np.nanmedian(np.abs(ran(pipeline, fields[1].views) - ran(pipeline, fields[2].views))) > 0.1  # they do differ


@pytest.mark.parametrize(
    "config", [CONFIG, configured("fast"), configured("learned")], ids=["paper", "fast", "learned"]
)
def test_captured_run_is_the_uncaptured_one(target: Any, config: Config) -> None:
    """Also with other views than those that it was captured with."""
    if target.device == "cpu":
        pytest.skip("nothing is captured on a CPU")
    pipeline = made(scene(), target, config)
    uncaptured = ran(pipeline)
    pipeline.run()
    assert np.quantile(np.abs(ran(pipeline) - uncaptured), 0.95) <= SAME
    where = {"backend": target.backend, "device": target.device}
    other = ran(DepthPipeline(scene(1), config=config, measured=pipeline.measured, **where))
    assert np.quantile(np.abs(ran(pipeline, scene(1).views) - other), 0.95) <= SAME


@pytest.mark.parametrize("solver", ["propagation.solver", "refinement.solver"])
def test_solvers_on_the_host_run_again_too(target: Any, solver: str) -> None:
    """A solver that needs the host is not captured, and gives the same again."""
    pipeline = made(scene(), target, CONFIG.with_values({solver: "lbfgsb", "refinement.max_iterations": 5}))
    first = ran(pipeline)
    for _ in range(2):
        assert_same(ran(pipeline), first, target)


def test_run_estimate_and_estimate_depth_are_one_method(target: Any) -> None:
    lf = scene(damaged=True)
    pipeline = made(lf, target)
    estimated = pipeline.estimate()
    again = pipeline.result()
    assert_same_result(again, estimated)
    assert again.timings == estimated.timings
    assert_same(ran(pipeline), estimated.disparity, target)
    direct = estimate_depth(lf, config=CONFIG, disparity_range=RANGE, backend=target.backend, device=target.device)
    assert_same(direct.disparity, estimated.disparity, target)
    assert_same(direct.confidence, estimated.confidence, target)


def assert_same_result(one: DepthResult, other: DepthResult) -> None:
    """Bit for bit, since nothing is computed in between."""
    np.testing.assert_array_equal(one.disparity, other.disparity)
    np.testing.assert_array_equal(one.confidence, other.confidence)
    assert one.stages.keys() == other.stages.keys()
    for stage, values in one.stages.items():
        np.testing.assert_array_equal(values, other.stages[stage])
    assert (one.status, one.trace, one.converged) == (other.status, other.trace, other.converged)
    assert (one.disparity_range, one.config, one.position) == (other.disparity_range, other.config, other.position)


def test_result_is_that_of_the_last_run(target: Any) -> None:
    pipeline = made(scene(), target)
    pipeline.estimate()
    disparity = ran(pipeline, scene(1).views)
    result = pipeline.result()
    np.testing.assert_array_equal(result.disparity, disparity)
    np.testing.assert_array_equal(result.stages["refine"], disparity)
    fresh = made(scene(1), target).estimate()
    assert_same(result.confidence, fresh.confidence, target)
    assert result.trace[0] == pytest.approx(fresh.trace[0], rel=1e-6 if target.device == "cpu" else 1e-3)


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_views_of_any_stored_type_go_in(target: Any, dtype: str) -> None:
    fields = [scenes.make("relief", grid=(3, 3), size=(40, 44), seed=seed, dtype=dtype) for seed in range(2)]
    pipeline = made(fields[0], target)
    assert_same(ran(pipeline, fields[1].views), ran(made(fields[1], target)), target)


def test_range_is_found_once_from_the_first_views() -> None:
    pipeline = DepthPipeline(scene(), config=CONFIG, device="cpu")
    bounds = pipeline.bounds
    assert bounds == estimate_depth(scene(), config=CONFIG, device="cpu").disparity_range
    ran(pipeline, scene(1).views)
    assert pipeline.result().disparity_range == bounds


# --- what is refused ---


WRONG = [
    (lambda views: views[:-1], "uint8 [14, 32, 36, 3]"),
    (lambda views: views[..., :1], "uint8 [15, 32, 36, 1]"),
    (lambda views: views[:, :, :-1], "uint8 [15, 32, 35, 3]"),
    (lambda views: views.swapaxes(1, 2), "uint8 [15, 36, 32, 3]"),
    (lambda views: views[0], "uint8 [32, 36, 3]"),
    (lambda views: views.astype(np.float32), "float32 [15, 32, 36, 3]"),
    (lambda views: views.astype(np.uint16), "uint16 [15, 32, 36, 3]"),
]


def test_views_of_another_kind_are_refused_and_change_nothing(target: Any) -> None:
    pipeline = made(scene(), target)
    want = ran(pipeline)
    for wrong, found in WRONG:
        with pytest.raises(LightFieldError) as error:
            pipeline.upload(wrong(scene(1).views))
        assert str(error.value) == (
            f"views must be uint8 [15, 32, 36, 3], like those that the pipeline was made for; found {found}."
        )
    assert_same(ran(pipeline), want, target)


def test_views_without_texture_have_no_map_and_leave_no_trace(target: Any) -> None:
    lf = scene()
    pipeline = made(lf, target)
    want = ran(pipeline)
    for _ in range(2):  # the second is captured on a GPU
        pipeline.upload(np.full_like(lf.views, 128))
        pipeline.run()
        with pytest.raises(LightFieldError, match=r"relief: no pixel has a coherent estimate .*\.$"):
            pipeline.disparity()
    assert_same(ran(pipeline, lf.views), want, target)


@pytest.mark.parametrize("config", ["accurate", "surest"])
def test_views_that_show_nothing_have_no_map_in_pipelines_and_streams(config: Any) -> None:
    lf = scene()
    blank, sentence = np.full_like(lf.views, 128), "no pixel (shows anything|matches)"
    pipeline = lfgpu.DepthPipeline(lf, config=config, disparity_range=(-2, 2), device="cpu")
    pipeline.upload(blank)
    pipeline.run()
    for read in (pipeline.disparity, pipeline.result, pipeline.estimate):
        with pytest.raises(LightFieldError, match=sentence):
            read()
    with lfgpu.DepthStream(lf, config=config, disparity_range=(-2, 2), device="cpu") as stream:
        for views in (lf.views, blank):  # the first map is no reason for a second one
            result = stream.push(views)
            assert result.wait()
        assert re.search(sentence, str(result.error))


def test_pipeline_refuses_what_estimate_depth_refuses() -> None:
    lf = scene()
    for options in ({"disparity_range": (1, 1)}, {"config": "best"}, {"backend": "fpga"}, {"device": "tpu"}):
        with pytest.raises(lfgpu.LfgpuError) as one:
            lfgpu.DepthPipeline(lf, **options)  # type: ignore[arg-type]
        with pytest.raises(lfgpu.LfgpuError) as other:
            lfgpu.estimate_depth(lf, **options)  # type: ignore[arg-type]
        assert (type(one.value), str(one.value)) == (type(other.value), str(other.value))


def test_what_was_never_run_has_no_result() -> None:
    pipeline = DepthPipeline(scenes.make("relief", grid=(3, 3), size=(24, 24)), disparity_range=(-1, 1), device="cpu")
    for ask in (pipeline.disparity, pipeline.result):
        with pytest.raises(lfgpu.LightFieldError, match=r"nothing has been estimated yet; call run\(\)"):
            ask()


def test_what_is_not_deterministic_is_refused_when_it_must_be(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = load("reference")
    assert DepthPipeline(scene(), disparity_range=RANGE, backend="reference", deterministic=True).device == "cpu"
    monkeypatch.setattr(kernels, "is_deterministic", lambda device: False)
    with pytest.raises(BackendError, match="differs from run to run"):
        DepthPipeline(scene(), disparity_range=RANGE, backend="reference", deterministic=True)
    DepthPipeline(scene(), disparity_range=RANGE, backend="reference")


@pytest.mark.parametrize("config", ["fast", "surest", "paper"])
def test_memory_is_free_once_a_pipeline_is_dropped(config: Any, target: Any) -> None:
    """It waits for no garbage collection, of whose need Python judges by the number of objects, not by their size."""
    lf = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    pipeline = DepthPipeline(lf, config=config, backend=target.backend, device=target.device)
    pipeline.estimate()
    arrays = [weakref.ref(array) for kind in pipeline._buffers._lent.values() for array in kind]
    gc.disable()
    try:
        del pipeline
        assert arrays
        assert not [array for array in arrays if array() is not None]
    finally:
        gc.enable()


@pytest.mark.parametrize("damaged", [False, True])
def test_views_that_are_not_used_stay_on_the_host(target: Any, damaged: bool) -> None:
    config = configured("fast")
    first, second = (scenes.make("relief", grid=(5, 5), size=(32, 36), seed=seed) for seed in (0, 1))
    if damaged:
        first, second = (masked(lf, np.s_[:, 5:9, 4:12]) for lf in (first, second))
    used = [2, 7, 10, 11, 12, 13, 14, 17, 22]
    pipeline, others = made(first, target, config), second.views.copy()
    assert len(target.kernels.numpy(pipeline._front.frame)) == len(used)
    others[[index for index in range(25) if index not in used]] = 0
    # The range and the noise are those of the first light field.
    measured = DepthPipeline(
        second, config=config, measured=pipeline.measured, backend=target.backend, device=target.device
    )
    assert_same(ran(pipeline, others), ran(measured), target)


@pytest.mark.parametrize("chosen", [None, [0], [1, 2, 3], [0, 2, 3, 4, 6], [6, 1]])
@pytest.mark.parametrize("kind", ["image", "field"])
def test_chosen_parts_of_an_array_are_uploaded(target: Any, chosen: list[int] | None, kind: str) -> None:
    kernels, device = target.kernels, target.device
    values = np.random.default_rng(0).integers(0, 255, (7, 5, 6, 3), np.uint8)
    if kind == "field":
        values = values[..., 0].astype(np.float32)
    wanted = values if chosen is None else values[chosen]
    array = getattr(kernels, kind)(np.zeros_like(wanted), device)
    kernels.upload(values, array, chosen=chosen)
    np.testing.assert_array_equal(kernels.numpy(array), wanted)


def test_staged_parts_are_all_bytes_in_order() -> None:
    pytest.importorskip("warp")
    from lfgpu.kernels.warp.memory import parts_of

    values = np.random.default_rng(0).integers(0, 255, 1000, np.uint8)
    pieces = [values[:300], values[300:301], values[301:301], values[301:]]
    parts = [np.concatenate(part) for part in parts_of(pieces, 128)]
    assert [len(part) for part in parts] == 7 * [128] + [104]
    np.testing.assert_array_equal(np.concatenate(parts), values)
    assert parts_of([values[:0]], 128) == []

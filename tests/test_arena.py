"""The memory of a plan: what is lent, and that nothing reads what scratch held before."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfgpu import DepthPipeline, scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.methods.arena import Arena


def written(kernels: Any, buffer: Any, value: float) -> None:
    kernels.upload(np.full(kernels.numpy(buffer).shape, value, kernels.numpy(buffer).dtype), buffer)


@pytest.mark.parametrize("backend", ["warp", "taichi", "reference"])
def test_scopes_that_follow_share_and_nested_ones_do_not(backend: str) -> None:
    kernels = load(backend)
    arena = Arena(Device(kernels, "cpu"))
    with arena.scratch() as scratch:
        first, second = scratch.field((8, 6)), scratch.field((8, 6))
        with arena.scratch() as inner:
            other = inner.field((8, 6))
    for buffer, value in ((first, 1.0), (second, 2.0), (other, 3.0)):
        written(kernels, buffer, value)
    assert [float(kernels.numpy(buffer).min()) for buffer in (first, second, other)] == [1.0, 2.0, 3.0]
    with arena.scratch() as scratch:
        again = scratch.field((8, 6))
    written(kernels, again, 7.0)
    assert sum(float(kernels.numpy(buffer).min()) == 7.0 for buffer in (first, second, other)) == 1


def test_scratch_of_another_kind_lies_in_what_it_fills_a_quarter_of() -> None:
    kernels = load("warp")
    arena = Arena(Device(kernels, "cpu"))
    with arena.scratch() as scratch:
        home = scratch.field((8, 8))
    with arena.scratch() as scratch:
        within, small = scratch.image((8, 8, 3), np.uint8), scratch.field((3, 5))
    written(kernels, home, 0.0)
    written(kernels, within, 255)
    written(kernels, small, 1.0)
    assert np.isnan(kernels.numpy(home)).sum() == 48  # 192 of its 256 bytes
    assert (kernels.numpy(home).ravel()[48:] == 0).all()


@pytest.mark.parametrize(
    ("preset", "widest", "is_masked"),
    [("surest", 12, False), ("surest", 2, True), ("accurate", 12, True), ("learned", 12, False), ("fast", 12, True)],
)
def test_maps_do_not_depend_on_what_shares_scratch_or_what_it_held(
    preset: str, widest: float, is_masked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lf = scenes.make("boxes", grid=(5, 5), size=(96, 96), disparity_range=(-widest, widest))
    if is_masked:
        lf = replace(lf, valid=np.random.default_rng(0).random(lf.views.shape[:-1]) > 0.1)

    def planned() -> DepthPipeline:
        return DepthPipeline(lf, config=preset, disparity_range=(-widest, widest), backend="warp", device="cpu")

    lent: list[Any] = []
    lend = Arena.lend

    def remembered(arena: Arena, kind: Any, scope: Any) -> Any:
        buffer = lend(arena, kind, scope)
        if arena.kernels.name == "warp":  # a dry run has an arena, too
            lent.append(buffer)
        return buffer

    with monkeypatch.context() as patch:
        patch.setattr(Arena, "lend", lambda arena, kind, scope: arena._made(kind))
        want = planned().estimate()
    monkeypatch.setattr(Arena, "lend", remembered)
    pipeline = planned()
    results = [pipeline.estimate()]
    assert len(lent) > 10
    for buffer in lent:
        values = pipeline.kernels.numpy(buffer)
        written(pipeline.kernels, buffer, np.nan if values.dtype.kind == "f" else np.iinfo(values.dtype).max)
    results.append(pipeline.estimate())
    for got in results:
        np.testing.assert_array_equal(got.disparity, want.disparity)
        np.testing.assert_array_equal(got.confidence, want.confidence)

"""The memory of a plan: what is lent, and that nothing reads what scratch held before."""

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


@pytest.mark.parametrize("preset", ["surest", "accurate", "fast"])
def test_maps_do_not_depend_on_what_scratch_held(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lent: list[Any] = []
    lend = Arena.lend

    def remembered(arena: Arena, kind: Any) -> Any:
        buffer = lend(arena, kind)
        if arena.kernels.name == "warp":  # a dry run has an arena, too
            lent.append(buffer)
        return buffer

    monkeypatch.setattr(Arena, "lend", remembered)
    lf = scenes.make("boxes", grid=(5, 5), size=(48, 64))
    pipeline = DepthPipeline(lf, config=preset, backend="warp", device="cpu")
    want = pipeline.estimate()
    assert len(lent) > 10
    for buffer in lent:
        values = pipeline.kernels.numpy(buffer)
        written(pipeline.kernels, buffer, np.nan if values.dtype.kind == "f" else np.iinfo(values.dtype).max)
    got = pipeline.estimate()
    np.testing.assert_array_equal(got.disparity, want.disparity)
    np.testing.assert_array_equal(got.confidence, want.confidence)

"""The cameras of a stream are watched: gains follow, a rig that has moved is said, and nothing else is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from stream_runs import pushing

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import RigWatch
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.rectifier import Rectifier

LONG = 300.0  # seconds: nothing takes that long unless it hangs


@cache
def boxes() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(128, 144), seed=1, noise=0.004)


def straight() -> Rectifier:
    """Of cameras that need no rectification."""
    lf = boxes()
    y, x = np.mgrid[: lf.size[0], : lf.size[1]].astype(np.float32)
    places = np.repeat(np.stack([x, y], -1)[None], len(lf.views), axis=0)
    tones = np.repeat(np.array([1.0, 0.0, 0.0])[None, :, None], len(lf.views), axis=0).repeat(3, axis=2)
    return Rectifier(places, np.zeros_like(places[..., 0]), tones, lf.positions, lf.reference_index)


@contextmanager
def filmed(**options: object) -> Iterator[tuple[lfgpu.DepthStream, SimpleNamespace]]:
    """A stream into which a camera pushes one frame after the other: its `views`, which may change."""
    lf = boxes()
    given = {"config": "fast", "disparity_range": (-2.0, 2.0), "device": "cpu", "prior": None, "policy": "block"}
    camera = SimpleNamespace(views=lf.views.copy())
    stream = lfgpu.DepthStream(lf, **{**given, **options})  # type: ignore[arg-type]
    with stream, pushing(lambda: stream.push(camera.views).wait()):
        yield stream, camera


def test_gains_follow_and_a_moved_camera_is_said_after_two_looks() -> None:
    said: list[tuple[str, ...]] = []
    rectifier = straight()
    with filmed(rectifier=rectifier) as (stream, camera):
        watch = RigWatch(stream, every=None, rate=0.7, on_finding=said.append)
        assert watch.look(timeout=LONG) == ()
        assert watch.looks == 1
        darker = camera.views.copy()
        darker[1] = np.rint(0.8 * darker[1])
        camera.views = darker
        for _ in range(3):
            assert watch.look(timeout=LONG) == ()
        gain = stream.rectifier.tones[:, 0].mean(axis=1)
        assert gain[1] == pytest.approx(0.8, abs=0.02)
        np.testing.assert_allclose(np.delete(gain, 1), 1.0, rtol=0, atol=0.02)
        moved = darker.copy()
        moved[7] = np.roll(moved[7], 2, axis=1)
        camera.views = moved
        found = [watch.look(timeout=LONG) for _ in range(3)]
        assert any(found)
        assert "row 2, column 1" in found[-1][0]
        assert "to the right" in found[-1][0]
        assert len(said) == 1
        camera.views = darker
        assert [watch.look(timeout=LONG) for _ in range(2)][-1] == ()


def test_the_watch_looks_by_itself_and_ends() -> None:
    with filmed() as (stream, _), RigWatch(stream, every=0.01) as watch:
        while watch.looks < 2:
            watch.look(timeout=LONG)
        assert watch.findings == ()


def test_a_snapshot_is_the_frame_and_its_result() -> None:
    with filmed(rectifier=straight()) as (stream, _):
        shown = stream.snapshot(timeout=LONG)
        assert shown is not None
        lf, result = shown
        used = list(stream.used_views)
        off = np.abs(lf.views.astype(int) - boxes().views[used])
        assert off.max() == 0
        np.testing.assert_array_equal(lf.positions, boxes().positions[used])
        assert np.isfinite(result.numpy()).all()
    assert stream.snapshot(timeout=LONG) is None  # closed


def test_wrong_numbers_are_refused() -> None:
    with filmed() as (stream, _):
        with pytest.raises(LightFieldError, match="every must be"):
            RigWatch(stream, every=0.0)
        with pytest.raises(LightFieldError, match="rate a share"):
            RigWatch(stream, rate=2.0)

"""Pictures with stamps become frames: what belongs together, what is lost, late or repeated, and nobody waits."""

import threading

import numpy as np
import pytest

import lfgpu
from lfgpu.errors import LightFieldError

SHAPE = (4, 5, 3)


def grouper(cameras: int = 3, **options: object) -> lfgpu.FrameGrouper:
    return lfgpu.FrameGrouper(cameras, **{"shape": SHAPE, "tolerance": 0.004, **options})  # type: ignore[arg-type]


def picture(value: int) -> np.ndarray:
    return np.full(SHAPE, value, np.uint8)


def taken(group: lfgpu.FrameGroup | None) -> lfgpu.FrameGroup:
    assert group is not None
    return group


def test_pictures_of_one_moment_are_a_frame_whatever_their_order() -> None:
    g = grouper(patience=0.05)
    frame_time, order = 1 / 30, ((1, 0), (0, 1), (0, 0), (2, 1), (2, 0), (1, 1))
    for camera, moment in order:  # the cameras' clocks differ by a millisecond
        assert g.add(camera, picture(10 * moment + camera), moment * frame_time + 0.001 * camera)
    for moment in (0, 1):
        group = taken(g.get(0))
        assert group.valid.all()
        assert group.views[:, 0, 0, 0].tolist() == [10 * moment, 10 * moment + 1, 10 * moment + 2]
        assert group.stamp == pytest.approx(moment * frame_time + 0.001)
    assert g.get(0) is None
    stats = g.stats()
    assert (stats["groups"], stats["complete"], stats["lost"], stats["late"]) == (2, 2, 0, 0)


def test_a_camera_that_is_silent_is_lost_and_then_late() -> None:
    g = grouper()
    g.add(0, picture(1), 0.0)
    g.add(2, picture(3), 0.001)
    assert g.get(0) is None  # camera 1 may still come
    g.add(0, picture(4), 0.033)  # patience: four tolerances
    group = taken(g.get(0))
    assert group.valid.tolist() == [True, False, True]
    assert np.isnan(group.stamps).tolist() == [False, True, False]
    assert (group.views[1] == 0).all()
    assert not g.add(1, picture(2), 0.002)
    stats = g.stats()
    assert (stats["groups"], stats["complete"], stats["lost"], stats["late"]) == (1, 0, 1, 1)


def test_what_is_lost_late_or_repeated_is_counted() -> None:
    g = grouper()
    assert g.add(0, picture(1), 0.0)
    assert not g.add(0, picture(9), 0.001)
    g.close()
    assert taken(g.get(0)).views[0, 0, 0, 0] == 1
    assert g.stats()["repeated"] == 1
    g = grouper(2, waiting=1)
    for moment in range(3):
        for camera in range(2):
            g.add(camera, picture(moment), moment * 0.1)
    assert taken(g.get(0)).views[0, 0, 0, 0] == 2
    assert g.stats()["dropped"] == 2
    g = grouper()
    g.add(0, picture(1), 0.0)
    g.close()
    assert [group.valid.tolist() for group in g] == [[True, False, False]]
    assert not g.add(1, picture(1), 0.0)
    g = grouper(2, waiting=100)
    for moment in range(80):
        g.add(0, picture(0), moment * 0.1)
        g.add(1, picture(0), moment * 0.1 + 0.003)
    assert g.stats()["delays"] == pytest.approx([-0.0015, 0.0015], abs=2e-4)


def test_recorders_in_threads_and_nothing_is_mixed_up() -> None:
    g = grouper(4, waiting=1000, tolerance=0.01, patience=50.0)
    frames = 60

    def record(camera: int) -> None:
        for moment in range(frames):
            g.add(camera, picture(moment), moment + 0.001 * camera)

    threads = [threading.Thread(target=record, args=(camera,)) for camera in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    g.close()
    for group in g:
        values = group.views[group.valid]
        assert (values == round(group.stamp)).all()
    stats = g.stats()
    assert stats["groups"] * 4 == 4 * frames - stats["late"] + stats["lost"]


def test_wrong_numbers_and_pictures_are_refused() -> None:
    for name, value, words in (
        ("tolerance", 0.0, "tolerance"),
        ("patience", 0.001, "patience"),
        ("tolerance", None, "tolerance must be a number of seconds"),
        ("waiting", 0, "waiting must be a whole number"),
        ("cameras", "two", "cameras must be a whole number"),
        ("shape", (4,), r"shape must be \(height, width, channels\) or \(height, width\), whole"),
        ("shape", (0, 5, 3), "shape must be"),
        ("shape", "4x5", "shape must be"),
    ):
        with pytest.raises(LightFieldError, match=words):
            grouper(**{name: value})
    g = grouper()
    for camera in (3, -1, 1.0, "left"):
        with pytest.raises(LightFieldError, match="camera must be a whole number from 0 to 2"):
            g.add(camera, picture(0), 0.0)  # type: ignore[arg-type]
    with pytest.raises(LightFieldError, match=r"must be \[4, 5, 3\]"):
        g.add(0, picture(0)[:2], 0.0)
    with pytest.raises(LightFieldError, match="must be uint8"):
        g.add(0, picture(0).astype(np.float32), 0.0)
    for stamp in (float("nan"), "now", None):
        with pytest.raises(LightFieldError, match="the stamp of camera 0 must be a number of seconds, not"):
            g.add(0, picture(0), stamp)  # type: ignore[arg-type]

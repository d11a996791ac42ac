"""The examples run, and what they find is right."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from lfgpu import scenes

FOLDER = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tried() -> None:
    tried = {"first_depth_map", "own_camera_array", "live_stream", "compare_backends"}
    tried |= {"checkerboard", "opencv_cameras", "gstreamer_appsink", "ros2_node"}  # in test_camera_examples.py
    assert {path.stem for path in FOLDER.glob("*.py")} == tried


def test_first_depth_map(tmp_path: Path) -> None:
    result = example("first_depth_map").main(out=str(tmp_path / "map.png"), size=(40, 48))
    assert (tmp_path / "map.png").is_file()
    assert result.disparity.shape == (40, 48)


def test_own_camera_array() -> None:
    size = (48, 64)
    result = example("own_camera_array").main(size=size)
    lf = scenes.make("planes", grid=(5, 5), size=size)
    assert lf.truth is not None
    assert np.median(np.abs(result.disparity - lf.truth.disparity)) < 0.07
    assert result.depth is not None
    assert (result.depth > 0).all()


def test_live_stream() -> None:
    maps = example("live_stream").main(frames=3, size=(32, 40))
    assert [m.shape for m in maps] == [(32, 40)] * 3
    assert (maps[0] != maps[2]).any()


def test_compare_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    import lfgpu

    quick = [info for info in lfgpu.describe_backends() if info.name != "taichi"]  # its start alone takes seconds
    monkeypatch.setattr(lfgpu, "describe_backends", lambda: quick, raising=False)
    results = example("compare_backends").main(size=(24, 32))
    assert {"warp", "reference"} <= results.keys()
    assert np.median(np.abs(results["warp"].disparity - results["reference"].disparity)) < 1e-3

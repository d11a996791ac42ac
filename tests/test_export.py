"""What is exported gives the same bits without Python as with it."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from lfgpu.kernels.warp import recording as exporting
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.io import write_hci
from lfgpu.threads import get_threads

RANGE = (-1.0, 1.0)
SIZE = (36, 40)


@cache
def frames() -> tuple[LightField, ...]:
    return tuple(scenes.make(name, grid=(3, 3), size=SIZE, disparity_range=RANGE) for name in ("planes", "boxes"))


def maps_of(config: str) -> np.ndarray:
    """[frame, map, y, x] with Python."""
    pipeline = lfgpu.DepthPipeline(frames()[0], config=config, disparity_range=RANGE, device="cpu")
    maps = []
    for lf in frames():
        pipeline.upload(lf.views)
        pipeline.run()
        result = pipeline.result()
        maps.append([result.disparity, result.confidence])
    return np.array(maps)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    libraries, _ = exporting.libraries()
    names = ["warp.so", "warp-clang.so"]
    if compiler is None or not all((libraries / name).is_file() for name in names):
        pytest.skip("no C++ compiler, or no libraries of Warp for it to link with, here")
    folder = tmp_path_factory.mktemp("program")
    source = Path(lfgpu.__file__).parent / "native" / "replay.cpp"
    linked = [f"-L{libraries}", *(f"-l:{name}" for name in names), f"-Wl,-rpath,{libraries}"]
    command = [compiler, "-O1", "-std=c++17", "-Wall", "-Wextra", "-Werror", str(source), "-o", str(folder / "replay")]
    subprocess.run([*command, *linked], check=True, capture_output=True, text=True)
    return folder / "replay"


def replayed(program: Path, *arguments: Path | str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=600, check=False)


@pytest.mark.parametrize("config", ["accurate", "fast"])
def test_same_bits_without_python(program: Path, tmp_path: Path, config: str) -> None:
    threads = get_threads()
    lfgpu.export_pipeline(frames()[0], tmp_path / "out", config=config, disparity_range=RANGE)
    assert get_threads() == threads
    views = np.stack([lf.views for lf in frames()])
    views.tofile(tmp_path / "frames.raw")
    done = replayed(program, tmp_path / "out", tmp_path / "frames.raw", tmp_path / "maps.raw")
    assert done.returncode == 0, done.stderr
    got = np.fromfile(tmp_path / "maps.raw", np.float32).reshape(2, 2, *SIZE)
    np.testing.assert_array_equal(got, maps_of(config))
    assert not np.array_equal(got[0], got[1])


def test_mistakes_of_those_who_replay(program: Path, tmp_path: Path) -> None:
    lfgpu.export_pipeline(frames()[0], tmp_path / "out", config="fast", disparity_range=RANGE)
    (tmp_path / "half.raw").write_bytes(b"\0" * 1000)
    maps = tmp_path / "maps.raw"
    for arguments, sentence in (
        ((), "usage"),
        ((tmp_path, tmp_path / "half.raw", maps), "give a folder that lfgpu export made"),
        ((tmp_path / "out", tmp_path / "nothing.raw", maps), "nothing.raw cannot be read"),
        ((tmp_path / "out", tmp_path / "half.raw", maps), "ends in the middle of a frame"),
    ):
        done = replayed(program, *arguments)
        assert done.returncode == 1
        assert sentence in done.stderr
    (tmp_path / "out" / "warp-version.txt").write_text("0.0.1\n")
    assert "Version mismatch" in replayed(program, tmp_path / "out", tmp_path / "half.raw", maps).stderr


def test_command_and_what_it_writes(tmp_path: Path) -> None:
    write_hci(frames()[0], tmp_path / "in")
    arguments = ["export", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--preset=fast", "--disparity-range=-1,1"]
    outcome = CliRunner().invoke(app, arguments)
    assert outcome.exit_code == 0, outcome.output
    about = json.loads((tmp_path / "out" / "pipeline.json").read_text())
    assert about["views"] == {"shape": [9, *SIZE, 3], "dtype": "uint8", "order": "n, y, x, c"}
    assert about["disparity_range"] == [-1, 1]
    assert str(9 * SIZE[0] * SIZE[1] * 3) in (tmp_path / "out" / "README.txt").read_text()
    assert (tmp_path / "out" / "replay.cpp").is_file()


def test_command_reads_as_depth_does(tmp_path: Path) -> None:
    views = frames()[0].views
    np.save(tmp_path / "views.npy", views[:6])
    arguments = ["export", str(tmp_path / "views.npy"), "-o", str(tmp_path / "out"), "--disparity-range=-1,1"]
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 1
    assert "6 views" in refused.stderr
    assert not (tmp_path / "out").exists()
    given = ["--preset=fast", "--format=numpy", "--grid=3x2", "--flip=v"]
    outcome = CliRunner().invoke(app, [*arguments, *given])
    assert outcome.exit_code == 0, outcome.output
    about = json.loads((tmp_path / "out" / "pipeline.json").read_text())
    expected = lfgpu.read(tmp_path / "views.npy", grid=(3, 2), flip="v")
    assert about["offsets"] == expected.offsets.tolist()


def test_only_matching_is_exported(tmp_path: Path) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="the method synthesis cannot be exported"):
        lfgpu.export_pipeline(frames()[0], tmp_path / "out", config="paper", disparity_range=RANGE)
    assert not (tmp_path / "out").exists()

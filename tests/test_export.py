"""Exported pipelines give the same bits without Python as with it: what a C++ compiler is needed for is thorough."""

import json
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu as run_command, refused, said
from lfgpu.kernels.warp import recording as exporting

import lfgpu
from lfgpu import Rectifier, scenes
from lfgpu.calibration import Calibration, Misalignment, disturb, rectify
from lfgpu.data import LightField
from lfgpu.io import write_hci
from lfgpu.threads import get_threads

RANGE = (-1.0, 1.0)
SIZE = (36, 40)
NATIVE = Path(lfgpu.__file__).parent / "native"


@cache
def frames() -> tuple[LightField, ...]:
    return tuple(scenes.make(name, grid=(3, 3), size=SIZE, disparity_range=RANGE) for name in ("planes", "boxes"))


CHECKED = "-fsanitize=address,undefined -fno-sanitize-recover=all"
"""Flags with which a program ends at the first access outside of its memory, at leaks and at undefined behaviour."""

FILM = 5
"""Frames: a scene that moves, and then another one."""


@cache
def film() -> tuple[LightField, ...]:
    options = {"grid": (3, 3), "size": SIZE, "disparity_range": RANGE}
    moving = scenes.sequence("moving", frames=60, noise=0.01, **options)
    return (*(lf for lf, _ in zip(moving, range(FILM - 1), strict=False)), scenes.make("planes", **options))


def streamed(config: str, prior: lfgpu.TemporalPrior | None) -> tuple[np.ndarray, list[bool]]:
    """[frame, map, y, x] with Python, and which frames started without the map before."""
    options = {"config": config, "disparity_range": RANGE, "device": "cpu", "policy": "block", "prior": prior}
    with lfgpu.DepthStream(film()[0], **options) as stream:
        results = [stream.push(lf.views) for lf in film()]
        return np.array([[r.numpy(), r.confidence()] for r in results]), [r.cold for r in results]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder into which CMake installed the library and the program."""
    cmake, libraries = shutil.which("cmake"), exporting.libraries()[0]
    if cmake is None or not (libraries / "warp.so").is_file() or shutil.which("c++") is None:
        pytest.skip("no CMake, no C++ compiler, or no libraries of Warp for it to link with, here")
    folder = tmp_path_factory.mktemp("cmake")
    flags = f"-DWARP={libraries.parent}", f"-DCMAKE_CXX_FLAGS=-O1 -Wall -Wextra -Werror {CHECKED}"
    run(cmake, "-S", NATIVE, "-B", folder / "build", *flags)
    run(cmake, "--build", folder / "build")
    run(cmake, "--install", folder / "build", "--prefix", folder / "installed")
    return folder / "installed"


@pytest.fixture(scope="module")
def program(built: Path) -> Path:
    return built / "bin" / "replay"


def run(*command: Path | str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def replayed(program: Path, *arguments: Path | str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=600, check=False)


@pytest.mark.thorough
@pytest.mark.parametrize("config", ["accurate", "fast", "learned", "surest"])
def test_same_bits_without_python(program: Path, tmp_path: Path, config: str) -> None:
    """Each frame starts from the map before, but the first one and the one of another scene."""
    threads = get_threads()
    lfgpu.export_pipeline(film()[0], tmp_path / "out", config=config, disparity_range=RANGE)
    assert get_threads() == threads
    np.stack([lf.views for lf in film()]).tofile(tmp_path / "frames.raw")
    want, cold = streamed(config, lfgpu.TemporalPrior())
    assert cold == [True, *[False] * (FILM - 2), True]
    for count in ("1", "3"):
        done = replayed(program, tmp_path / "out", tmp_path / "frames.raw", tmp_path / "maps.raw", "--threads", count)
        assert done.returncode == 0, done.stderr
        assert f"{FILM} frames, 2 without the map before" in done.stderr
        got = np.fromfile(tmp_path / "maps.raw", np.float32).reshape(want.shape)
        np.testing.assert_array_equal(got, want)
    assert not np.array_equal(want[1], streamed(config, None)[0][1])


@pytest.mark.thorough
def test_each_frame_on_its_own(program: Path, tmp_path: Path) -> None:
    lfgpu.export_pipeline(film()[0], tmp_path / "out", config="fast", disparity_range=RANGE, prior=None)
    assert not (tmp_path / "out" / "warm.wrp").exists()
    np.stack([lf.views for lf in film()]).tofile(tmp_path / "frames.raw")
    done = replayed(program, tmp_path / "out", tmp_path / "frames.raw", tmp_path / "maps.raw", "--repeat", "2")
    assert f"{2 * FILM} frames, {2 * FILM} without the map before" in done.stderr
    want, _ = streamed("fast", None)
    np.testing.assert_array_equal(np.fromfile(tmp_path / "maps.raw", np.float32).reshape(want.shape), want)


def raw_film() -> tuple[list[np.ndarray], Rectifier]:
    """The film as cameras record it that are out of line, and what puts it right."""
    wrong = Misalignment(shift=1, roll=0.3, distortion=0.02, gain=0.1, vignetting=0.1)
    seen = [disturb(lf, wrong, seed=2).light_field for lf in film()]
    cameras = disturb(film()[0], wrong, seed=2).cameras
    made = rectify(seen[0], calibration=Calibration(cameras, "rig", "lfgpu"))
    return [lf.views for lf in seen], made.rectifier()


@pytest.mark.thorough
@pytest.mark.parametrize("config", ["accurate", "fast"])
def test_raw_pictures_are_rectified_without_python(program: Path, tmp_path: Path, config: str) -> None:
    """All views are used by `accurate`, a star of them by `fast`."""
    raw, rectifier = raw_film()
    first = rectifier.pictures(raw[0])
    lfgpu.export_pipeline(first, tmp_path / "out", config=config, disparity_range=RANGE, rectifier=rectifier)
    np.stack(raw).tofile(tmp_path / "frames.raw")
    options = {"config": config, "disparity_range": RANGE, "device": "cpu", "policy": "block"}
    with lfgpu.DepthStream(first, rectifier=rectifier, **options) as stream:
        results = [stream.push(views) for views in raw]
        want = np.array([[r.numpy(), r.confidence()] for r in results])
    done = replayed(program, tmp_path / "out", tmp_path / "frames.raw", tmp_path / "maps.raw", "--threads", "2")
    assert done.returncode == 0, done.stderr
    got = np.fromfile(tmp_path / "maps.raw", np.float32).reshape(want.shape)
    np.testing.assert_array_equal(got, want)
    with lfgpu.DepthStream(first, **options) as stream:
        assert not np.array_equal(stream.push(raw[0]).numpy(), want[0, 0], equal_nan=True)
    assert "raw pictures" in (tmp_path / "out" / "README.txt").read_text()


USER = r"""
#include <lfgpu_replay.h>
#include <cstdio>
#include <thread>
#include <vector>

int main(int, char** arguments)
{
    // Two pipelines in two threads, with frames of zeros and of a gradient.
    std::vector<float> maps[2];
    auto solve = [&](int k) {
        lfgpu::Replay replay(arguments[1], 2);
        std::vector<unsigned char> views(replay.frame_bytes());
        for (std::size_t i = 0; i < views.size(); ++i) views[i] = static_cast<unsigned char>((i * i / 7) % 256);
        maps[k].resize(replay.pixels());
        for (int frame = 0; frame < 3; ++frame) {
            if (frame == 2) replay.restart();
            if (replay.solve(views.data(), maps[k].data(), nullptr) != (frame != 1)) std::printf("wrong start ");
        }
    };
    std::thread other(solve, 1);
    solve(0);
    other.join();
    try {
        lfgpu::Replay nothing("nowhere");
    } catch (const lfgpu::Error& error) {
        std::printf("%s|%d\n", error.what(), int(maps[0] == maps[1]));
    }
}
"""


@pytest.mark.thorough
def test_the_library_in_a_project_of_its_own(built: Path, tmp_path: Path) -> None:
    lfgpu.export_pipeline(film()[0], tmp_path / "out", config="fast", disparity_range=RANGE)
    (tmp_path / "user").mkdir()
    (tmp_path / "user" / "main.cpp").write_text(USER)
    (tmp_path / "user" / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(user CXX)\nfind_package(lfgpu_replay REQUIRED)\n"
        "add_executable(user main.cpp)\ntarget_link_libraries(user lfgpu::lfgpu_replay)\n"
    )
    flags = f"-DCMAKE_PREFIX_PATH={built}", f"-DCMAKE_CXX_FLAGS={CHECKED}"
    run("cmake", "-S", tmp_path / "user", "-B", tmp_path / "build", *flags)
    run("cmake", "--build", tmp_path / "build")
    done = subprocess.run([tmp_path / "build" / "user", tmp_path / "out"], capture_output=True, text=True, timeout=600)
    assert done.stdout == "nowhere/replay.txt cannot be read; give a folder that lfgpu export made.|1\n", done.stderr


@pytest.mark.thorough
def test_mistakes_of_those_who_replay(program: Path, tmp_path: Path) -> None:
    lfgpu.export_pipeline(frames()[0], tmp_path / "out", config="fast", disparity_range=RANGE)
    (tmp_path / "half.raw").write_bytes(b"\0" * 1000)
    maps = tmp_path / "maps.raw"
    for arguments, sentence in (
        ((), "usage"),
        ((tmp_path, tmp_path / "half.raw", maps), "give a folder that lfgpu export made"),
        ((tmp_path / "out", tmp_path / "nothing.raw", maps), "nothing.raw cannot be read"),
        ((tmp_path / "out", tmp_path / "half.raw", maps), "ends in the middle of a frame"),
        ((tmp_path / "out", tmp_path / "half.raw", maps, "--threads", "0"), "--threads must be a whole number"),
    ):
        done = replayed(program, *arguments)
        assert done.returncode == 1
        assert sentence in done.stderr
    about = tmp_path / "out" / "replay.txt"
    about.write_text(re.sub("^warp .*$", "warp 0.0.1", about.read_text(), flags=re.M))
    assert "Version mismatch" in replayed(program, tmp_path / "out", tmp_path / "half.raw", maps).stderr


def test_command_and_what_it_writes(tmp_path: Path) -> None:
    write_hci(frames()[0], tmp_path / "in")
    said("export", tmp_path / "in", "-o", tmp_path / "out", "--preset=fast", "--disparity-range=-1,1")
    about = json.loads((tmp_path / "out" / "pipeline.json").read_text())
    assert about["views"] == {"shape": [9, *SIZE, 3], "dtype": "uint8", "order": "n, y, x, c"}
    assert about["disparity_range"] == [-1, 1]
    assert str(9 * SIZE[0] * SIZE[1] * 3) in (tmp_path / "out" / "README.txt").read_text()
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {path.name for path in NATIVE.glob("*replay*")}


def test_command_reads_as_depth_does(tmp_path: Path) -> None:
    views = frames()[0].views
    np.save(tmp_path / "views.npy", views[:6])
    arguments = ["export", tmp_path / "views.npy", "-o", tmp_path / "out", "--disparity-range=-1,1"]
    refused(run_command(*arguments), "6 views")
    assert not (tmp_path / "out").exists()
    said(*arguments, "--preset=fast", "--format=numpy", "--grid=3x2", "--flip=v")
    about = json.loads((tmp_path / "out" / "pipeline.json").read_text())
    expected = lfgpu.read(tmp_path / "views.npy", grid=(3, 2), flip="v")
    assert about["offsets"] == expected.offsets.tolist()


@pytest.mark.parametrize("kilobytes", [50, 2000])
def test_what_a_full_disk_cannot_hold_is_a_sentence_and_leaves_nothing(tmp_path: Path, kilobytes: int) -> None:
    """The system refuses larger files, as a full disk does."""
    resource = pytest.importorskip("resource")
    lf = frames()[0]
    lfgpu.export_pipeline(lf, tmp_path / "whole", config="fast", disparity_range=(-2, 2))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000 * kilobytes, before[1]))
    try:
        with pytest.raises(lfgpu.LightFieldError, match="out cannot be written: File too large"):
            lfgpu.export_pipeline(lf, tmp_path / "out", config="fast", disparity_range=(-2, 2))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def test_only_matching_is_exported(tmp_path: Path) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="the method synthesis cannot be exported"):
        lfgpu.export_pipeline(frames()[0], tmp_path / "out", config="paper", disparity_range=RANGE)
    assert not (tmp_path / "out").exists()

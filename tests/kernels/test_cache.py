"""The cache of compiled kernels: a sentence where it cannot be written, and a new one where a crash left half."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("warp")

_CODE = """
import numpy as np
from lfgpu.errors import BackendError
from lfgpu._backends import load
try:
    kernels = load("warp")
    views = kernels.image(np.full((2, 8, 8, 3), 51, np.uint8), "cpu")
    image = kernels.zeros_image((8, 8, 3), "cpu")
    kernels.intensities(views, 0, None, scale=1 / 255, fill=0.0, image_out=image)
    print("done", float(kernels.numpy(image).mean()))
    residuals = kernels.residuals("cpu", tolerance=0.5, most=3)  # these are not loaded before they are launched
    residuals.begin(kernels.scalar(4.0, "cpu"))
    residuals.add(kernels.scalar(1.0, "cpu"))
    print("left", residuals.report())
except BackendError as error:
    print("refused:", error)
"""


def run(cache: Path | str) -> str:
    """In a process of its own, with another cache."""
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    done = subprocess.run([sys.executable, "-c", _CODE], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_a_cache_that_is_damaged_is_made_again(tmp_path: Path) -> None:
    """Cut short by a crash, with bits that were flipped, and with sums that are no trust."""
    first = run(tmp_path)
    assert first.startswith("done 0.2")
    assert first.endswith("left [0.5]\n")
    objects = [file for file in tmp_path.rglob("*") if file.suffix in (".o", ".so")]
    assert objects
    for file in objects:
        file.write_bytes(file.read_bytes()[:300])
    assert run(tmp_path) == first
    for file in objects:
        data = file.read_bytes()
        middle = len(data) // 2
        file.write_bytes(data[:64] + bytes(255 - byte for byte in data[64:middle]) + data[middle:])
    assert run(tmp_path) == first
    for file in objects:
        file.with_name(f"{file.name}.crc32").write_bytes(b"\xff")
    assert run(tmp_path) == first


@pytest.mark.thorough
@pytest.mark.parametrize("value", ["", "here"])
@pytest.mark.parametrize("name", ["XDG_CACHE_HOME", "WARP_CACHE_PATH"])
def test_no_native_code_is_kept_in_or_loaded_from_the_current_folder(tmp_path: Path, name: str, value: str) -> None:
    """A relative WARP_CACHE_PATH is an own wish; XDG_CACHE_HOME is none then, as its specification says."""
    (tmp_path / "now").mkdir()
    environment = {key: text for key, text in os.environ.items() if key != "WARP_CACHE_PATH"}
    environment |= {"HOME": str(tmp_path / "home"), name: value}
    done = subprocess.run(
        [sys.executable, "-c", _CODE], env=environment, cwd=tmp_path / "now", capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("done 0.2")
    is_wish = (name, value) == ("WARP_CACHE_PATH", "here")
    assert [path.name for path in (tmp_path / "now").iterdir()] == (["here"] if is_wish else [])


def test_all_kernels_are_launched_such_that_they_are_made_again() -> None:
    files = (Path(__file__).parents[2] / "kernels" / "warp").rglob("*.py")
    assert [file.name for file in files if "wp.launch" in file.read_text()] == ["threads.py"]


def test_a_cache_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    text = run(tmp_path / "file" / "cache")
    assert text.startswith("refused: ")
    assert "set WARP_CACHE_PATH" in text

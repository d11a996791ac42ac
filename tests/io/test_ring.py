"""Ring buffers in shared memory: frames arrive whole, in order, with their times, from Python and from C++."""

import os
import shutil
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu.io import ring as rings
from lfgpu.io.ring import RingReader, RingWriter

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="ring buffers need a POSIX system")

POSITIONS = [(0.0, 0.0), (1.0, 0.0), (2.5, 0.5)]
SIZE = (6, 7)
NATIVE = Path(lfgpu.__file__).parent / "native"
PRODUCER = Path(__file__).parents[2] / "examples" / "ring_producer.cpp"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig"


def pictures(value: int, dtype: Any = np.uint8) -> np.ndarray:
    return np.full((3, *SIZE, 3), value, dtype)


@pytest.mark.parametrize(("dtype", "channels"), [(np.uint8, 3), (np.uint8, 1), (np.uint16, 3), (np.float32, 3)])
def test_frames_come_as_they_were_written(path: Path, dtype: Any, channels: int, rng: np.random.Generator) -> None:
    kind, most = {"dtype": dtype, "channels": channels}, 1 if dtype is np.float32 else np.iinfo(dtype).max
    with RingWriter(path, POSITIONS, SIZE, reference=1, **kind) as writer, RingReader(path) as reader:
        np.testing.assert_array_equal(reader.positions, POSITIONS)
        assert reader.reference == 1
        assert reader.read() is None
        for number in range(1, 12):
            views = (rng.random((3, *SIZE, channels)) * most).astype(dtype)
            valid = rng.random(3) < 0.5
            assert writer.write(views, valid=valid, time_ns=100 + number) == number
            frame = reader.read()
            assert frame.views.dtype == dtype
            np.testing.assert_array_equal(frame.views, views)
            np.testing.assert_array_equal(frame.valid, valid)
            assert (frame.number, frame.time_ns, frame.passed) == (number, 100 + number, 0)
            assert reader.read() is None


def test_the_newest_frame_is_read(path: Path) -> None:
    with RingWriter(path, POSITIONS, SIZE) as writer, RingReader(path) as reader:
        for value in range(10):
            writer.write(pictures(value))
        frame = reader.read()
        assert (frame.number, frame.passed, frame.views.max()) == (10, 9, 9)


def overtake(reader: RingReader, writer: RingWriter, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the producer go round the whole ring during the first copies of views: they are torn."""
    fill, left = reader._fill, times

    def torn(array: np.ndarray, at: int) -> None:
        nonlocal left
        fill(array, at)
        if array.ndim == 4 and left > 0:
            left -= 1
            first = array[:1].copy()
            for value in (2, 3, 4):
                writer.write(pictures(value))
            fill(array, at)
            array[:1] = first

    monkeypatch.setattr(reader, "_fill", torn)


def test_a_frame_that_is_written_over_while_it_is_copied_is_not_taken(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RingWriter(path, POSITIONS, SIZE, slots=3) as writer, RingReader(path) as reader:
        writer.write(pictures(1))
        overtake(reader, writer, 1, monkeypatch)
        frame = reader.read()
        assert (frame.number, reader.repeated) == (4, 1)
        assert set(np.unique(frame.views)) == {4}


@pytest.mark.parametrize("newest", [2, 7, 2**63, 2**64 - 1])
def test_a_header_that_names_a_frame_which_no_slot_holds_is_damage(path: Path, newest: int) -> None:
    with RingWriter(path, POSITIONS, SIZE) as writer, RingReader(path) as reader:
        writer.write(pictures(1))
        with path.open("r+b") as file:
            file.seek(56)  # docs/live.md
            file.write(newest.to_bytes(8, "little"))
        for read in (reader.read, reader.wait):
            with pytest.raises(lfgpu.LightFieldError, match=f"is damaged: it says that frame {newest} is its newest"):
                read()


def test_a_producer_that_overtakes_its_reader_each_time_keeps_it_from_nothing_else(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RingWriter(path, POSITIONS, SIZE, slots=3) as writer, RingReader(path) as reader:
        writer.write(pictures(1))
        overtake(reader, writer, 1000, monkeypatch)
        assert reader.read() is None
        monkeypatch.undo()
        assert reader.read() is not None


def test_a_frame_that_is_not_finished_is_not_seen(path: Path) -> None:
    with RingWriter(path, POSITIONS, SIZE, slots=3) as writer, RingReader(path) as reader:
        for value in (1, 2, 3):
            writer.write(pictures(value))
        writer.begin()[:] = 9  # the slot of frame 1
        frame = reader.read()
        assert set(np.unique(frame.views)) == {3}


def test_readers_notice_that_the_producer_ends(path: Path) -> None:
    writer = RingWriter(path, POSITIONS, SIZE)
    with RingReader(path) as reader:
        assert not reader.ended()
        writer.write(pictures(5))
        writer.close()
        writer.close()
        assert not path.exists()
        frame = reader.wait()
        assert frame.views.max() == 5
        assert reader.wait() is None
    with pytest.raises(lfgpu.LfgpuError, match="closed"):
        writer.begin()


def test_readers_notice_that_the_producer_was_killed(path: Path) -> None:
    code = (
        "import os, sys\nfrom lfgpu.io.ring import RingWriter\nimport numpy as np\n"
        f"ring = RingWriter({str(path)!r}, {POSITIONS!r}, {SIZE!r})\n"
        f"ring.write(np.ones((3, {SIZE[0]}, {SIZE[1]}, 3), np.uint8))\nos._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600, env={**os.environ, "PYTHONPATH": _root()})
    with RingReader(path) as reader:
        assert reader.wait() is not None
        assert reader.wait() is None
    with RingWriter(path, POSITIONS, SIZE) as again, RingReader(path) as reader:  # what is left does not hinder
        again.write(pictures(3))
        assert reader.wait() is not None
        with pytest.raises(lfgpu.LightFieldError, match="has a producer already"):
            RingWriter(path, POSITIONS, SIZE)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"slots": 2}, "slots must be 3 to 1024"),
        ({"dtype": np.float64}, "views must be uint8, uint16 or float32"),
        ({"channels": 4}, "c = 1 or 3"),
        ({"reference": 3}, "reference view 3 does not exist"),
        ({"size": (0, 4)}, "views must be"),
        ({"positions": [(0, 0)]}, "at least two views"),
    ],
)
def test_rings_that_cannot_be(path: Path, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(lfgpu.LightFieldError, match=sentence):
        RingWriter(path, **{"positions": POSITIONS, "size": SIZE, **options})
    assert not list(path.parent.iterdir())


def test_frames_that_do_not_fit(path: Path) -> None:
    with RingWriter(path, POSITIONS, SIZE) as writer:
        with pytest.raises(lfgpu.LightFieldError, match=r"views must be uint8 \[3, 6, 7, 3\]"):
            writer.write(pictures(1)[:2])
        with pytest.raises(lfgpu.LfgpuError, match="no frame was begun"):
            writer.publish()
        writer.begin()
        with pytest.raises(lfgpu.LightFieldError, match=r"valid must be bool \[3\]"):
            writer.publish(valid=[True])


def ring_file(place: int = 0, value: Any = rings.MAGIC, size: int = 5 * 4096) -> bytes:
    """A ring by hand, one of whose numbers is another one."""
    fields = [rings.MAGIC, 1, 4096, 4096, 4, 3, *SIZE, 3, 1, 1, 0, 0]
    fields[place] = value
    return (struct.pack("<8sIIQIIIIIIIIQ", *fields) + np.array(POSITIONS, "<f8").tobytes()).ljust(size, b"\0")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        pytest.param(b"", "is no ring buffer", id="empty"),
        pytest.param(b"\x89PNG" + bytes(100), "is no ring buffer", id="picture"),
        pytest.param(ring_file(1, 2), "of version 2", id="version"),
        pytest.param(ring_file(size=2 * 4096), "does not fit", id="short"),
        pytest.param(ring_file(5, 2**32 - 1), "does not fit", id="many views"),
        pytest.param(ring_file(4, 2**32 - 1), "does not fit", id="many slots"),
        pytest.param(ring_file(3, 64), "does not fit", id="slot"),
        pytest.param(ring_file(9, 7), "does not fit", id="type"),
        pytest.param(ring_file(10, 3), "does not fit", id="reference"),
    ],
)
def test_files_that_are_no_rings(path: Path, content: bytes, sentence: str) -> None:
    path.write_bytes(content)
    with pytest.raises(lfgpu.LightFieldError, match=sentence):
        RingReader(path)


def test_a_ring_that_is_cut_short_while_it_is_read_ends_nothing_but_itself(path: Path) -> None:
    with RingWriter(path, POSITIONS, SIZE) as writer, RingReader(path) as reader:
        writer.write(pictures(1))
        os.truncate(path, 4096)
        with pytest.raises(lfgpu.LightFieldError, match="was cut short while it was read"):
            reader.read()
        os.truncate(path, 1 << 20)  # the producer has it mapped


def test_a_pipe_in_place_of_a_ring_is_not_waited_for(path: Path) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="start the producer first"):
        RingReader(path)
    os.mkfifo(path)
    with pytest.raises(lfgpu.LightFieldError, match="neither a file nor a folder"):
        RingReader(path)


# --- another process ---


def _root() -> str:
    return str(Path(__file__).parents[2])


def compiled(source: Path, program: Path, *flags: str) -> Path:
    names = ("cc", "gcc", "clang") if source.suffix == ".c" else ("c++", "g++", "clang++")
    compiler = next(filter(None, map(shutil.which, names)), None)
    if compiler is None:
        pytest.skip(f"no compiler of {source.suffix} here")
    options = ["-O1", "-Wall", "-Wextra", "-Werror", f"-I{NATIVE}", *flags]
    subprocess.run([compiler, *options, source, "-o", program], check=True, timeout=600)
    return program


def read_some(path: Path, command: list[Any], count: int) -> None:
    """Read frames of a producer of examples/, which has no end, and end it; each must be of the value of its number."""
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": _root()}) as process:
        try:
            while not path.exists():
                assert process.poll() is None
                time.sleep(0.01)
            with RingReader(path) as reader:
                last = 0
                for _ in range(count):
                    frame = reader.wait()
                    assert set(np.unique(frame.views)) == {frame.number % 251}
                    assert frame.number == last + 1 + frame.passed
                    last = frame.number
                process.kill()
                while reader.wait() is not None:
                    pass
        finally:
            process.kill()


@pytest.mark.thorough
def test_a_producer_in_cpp(path: Path, tmp_path: Path) -> None:
    """As fast as it can: it is many times round the ring while one frame is read."""
    producer = compiled(PRODUCER, tmp_path / "producer", "-std=c++17", "-Wpedantic")
    read_some(path, [producer, path, "3x3", "40x50", str(10**9), "0"], 1000)


def test_a_producer_in_python(path: Path) -> None:
    script = PRODUCER.with_suffix(".py")
    read_some(path, [sys.executable, script, path, "3x3", "40x50", str(10**9), "0"], 300)


@pytest.mark.thorough
def test_the_header_is_c_as_well(tmp_path: Path) -> None:
    source = tmp_path / "user.c"
    source.write_text(
        '#define _DEFAULT_SOURCE\n#include "lfgpu_ring.h"\n'
        "int main(void)\n{\n    lfgpu_ring ring;\n    double positions[4] = {0, 0, 1, 0};\n"
        "    lfgpu_ring_kind kind = {2, 4, 5, 1, LFGPU_RING_UINT16, 0, 3, positions};\n"
        f'    if (lfgpu_ring_create(&ring, "{tmp_path / "rig"}", &kind) != 0) return 1;\n'
        f'    if (lfgpu_ring_create(&ring, "{tmp_path / "rig"}", &kind) != -1 || errno != EBUSY) return 2;\n'
        "    kind.slots = 1;\n"
        f'    return lfgpu_ring_create(&ring, "{tmp_path / "other"}", &kind) == -1 && errno == EINVAL ? 0 : 3;\n}}\n'
    )
    assert subprocess.run([compiled(source, tmp_path / "user", "-std=c99")], timeout=600).returncode == 0
    with RingReader(tmp_path / "rig") as reader:
        assert reader._kind.shape == (2, 4, 5, 1)
        assert reader._kind.dtype == np.uint16
        assert reader.ended()

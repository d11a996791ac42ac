"""Frames from folders, scenes and grabbers become maps in a folder; temporal kernels do what they say."""

import json
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Outcome, lfgpu as run_command, said

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_hci
from lfgpu.pipelines.sources import open_source, recorded
from lfgpu.viewer.contents import opened_all

SCENE: dict[str, Any] = {"size": (32, 36), "disparity_range": (-1, 1)}
OPTIONS: dict[str, Any] = {"grid": (3, 3), **SCENE}
RANGE = "--disparity-range=-1,1"


def lfgpu_live(*arguments: object) -> Outcome:
    return run_command("live", *arguments, "--device=cpu")


def live(*arguments: object) -> str:
    return said("live", *arguments, "--device=cpu")


def sequence_of(frames: int) -> list[LightField]:
    return list(scenes.sequence("moving", frames=frames, **OPTIONS))


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    for index, lf in enumerate(scenes.sequence("moving", frames=12, **OPTIONS)):
        write_hci(lf, tmp_path / "in" / f"frame_{index}")
    return tmp_path / "in"


@pytest.fixture
def grabbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "grabber_for_tests.py").write_text(
        "import numpy as np\n"
        "from lfgpu import scenes\n"
        "def frames():\n"
        "    lf = scenes.make('planes', grid=(3, 3), size=(32, 36), disparity_range=(-1, 1))\n"
        "    yield lf\n"
        "    yield lf.views\n"
        "    yield lf.views[:, :4]\n"
        "    there = np.ones(9, bool)\n"
        "    there[2] = False\n"
        "    yield lf.views, there\n"
        "def nothing():\n"
        "    return iter(())\n"
        "def arrays():\n"
        "    yield np.zeros((9, 32, 36, 3), np.uint8)\n"
        "def unplugged():\n"
        "    lf = scenes.make('planes', grid=(3, 3), size=(32, 36), disparity_range=(-1, 1))\n"
        "    yield lf\n"
        "    yield lf.views\n"
        "    raise OSError('the camera was unplugged')\n"
        "def terminated():\n"
        "    lf = scenes.make('planes', grid=(3, 3), size=(32, 36), disparity_range=(-1, 1))\n"
        "    yield lf\n"
        "    yield lf.views\n"
        "    import os, signal\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    while True:\n"
        "        yield lf.views\n"
        "def number():\n"
        "    return 3\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "grabber_for_tests", raising=False)


def test_folder_in_the_order_of_its_numbers(sequence: Path) -> None:
    opened = open_source(str(sequence))
    first = opened.first
    found = [frame.views if isinstance(frame, LightField) else frame[0] for frame in opened.frames]
    want = [lf.views for lf in scenes.sequence("moving", frames=12, **OPTIONS)]
    np.testing.assert_array_equal(found, want)
    np.testing.assert_array_equal(first.views, want[0])


def test_recording_of_a_folder(sequence: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = live(sequence, "-o", out, "--preset=fast", RANGE, "--cold", "--frames=3")
    assert "3 of 3, 0 dropped, 0 failed, 3 cold" in text
    about = json.loads((out / "live.json").read_text())
    assert [frame["frame"] for frame in about["frames"]] == [0, 1, 2]
    assert about["stats"]["frames_done"] == 3
    lf = next(iter(scenes.sequence("moving", frames=12, **OPTIONS)))
    want = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-1, 1), device="cpu")
    np.testing.assert_array_equal(read_map(out / "disparity_000000.pfm"), want.disparity)
    np.testing.assert_array_equal(read_map(out / "confidence_000000.pfm"), want.confidence)
    assert len(list(out.iterdir())) == 3 * 2 + 1
    (out / "disparity_000007.pfm").write_bytes(b"of another program")
    before = {path.name for path in out.iterdir()}
    assert lfgpu_live(sequence, "-o", out, "--preset=fast", RANGE, "--budget=-1").code != 0
    assert {path.name for path in out.iterdir()} == before
    live(sequence, "-o", out, "--preset=fast", RANGE, "--cold", "--frames=2")
    assert before - {path.name for path in out.iterdir()} == {"disparity_000002.pfm", "confidence_000002.pfm"}


@pytest.fixture(scope="module")
def gaps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recorded frames, of which three were not kept, and the maps of them played again."""
    folder = tmp_path_factory.mktemp("gaps")
    frames = sequence_of(6)
    kept = iter((True, False, True, False, False, True))
    for _ in recorded(iter(frames), frames[0], folder / "film", wanted=lambda: next(kept)):
        pass
    live(folder / "film", "-o", folder / "maps", "--preset=fast", RANGE, "--cold")
    return folder


def test_maps_of_a_film_with_gaps_belong_to_its_frames(gaps: Path) -> None:
    contents = opened_all([gaps / "maps", gaps / "film"])
    assert list(contents.film.frames) == [0, 2, 5]
    for number, played in ((5, 2), (2, 1), (0, 0)):
        found = contents.turned(number).entries["maps"]
        np.testing.assert_array_equal(found.disparity, read_map(gaps / f"maps/disparity_{played:06d}.pfm"))
        np.testing.assert_array_equal(found.confidence, read_map(gaps / f"maps/confidence_{played:06d}.pfm"))


def test_maps_of_another_film_are_refused(gaps: Path, tmp_path: Path) -> None:
    lost = sequence_of(6)[4:5]  # one that was not kept
    for _ in recorded(iter(lost), lost[0], tmp_path / "other"):
        pass
    with pytest.raises(LightFieldError, match=r"maps holds maps of other frames: none is of .*frame_000000"):
        opened_all([tmp_path / "other", gaps / "maps"])
    (tmp_path / "maps").mkdir()
    for words in ("{}", '{"frames": [{"frame": 0}]}', "nonsense", '{"frames": [{"frame": Infinity, "reference": 0}]}'):
        (tmp_path / "maps" / "live.json").write_text(words)
        with pytest.raises(LightFieldError, match="does not say which frame each map is of"):
            opened_all([gaps / "film", tmp_path / "maps"])


def test_frames_of_two_recordings_do_not_mix(gaps: Path) -> None:
    outcome = lfgpu_live("planes", "--record", gaps / "film", "--frames=1")
    assert outcome.code == 1
    assert "holds frames already" in outcome.err


def test_grabber_with_a_bad_frame_and_a_missing_camera(grabbers: None, tmp_path: Path) -> None:
    arguments = ("-o", tmp_path / "out", "--preset=fast", RANGE, "--policy=block")
    text = live("grabber_for_tests:frames", *arguments)
    assert "3 of 4, 0 dropped, 1 failed" in text
    assert "Frame 2: views must be uint8 [9, 32, 36, 3]" in text
    frames = json.loads((tmp_path / "out" / "live.json").read_text())["frames"]
    assert [frame.get("views") for frame in frames] == [9, 9, None, 8]
    assert not (tmp_path / "out" / "disparity_000002.pfm").exists()


def test_what_came_before_a_source_failed_is_kept(grabbers: None, tmp_path: Path) -> None:
    """Maps without the log cannot be shown with their frames."""
    outcome = lfgpu_live("grabber_for_tests:unplugged", "-o", tmp_path / "out", "--preset=fast", RANGE)
    assert outcome.code == 1
    frames = json.loads((tmp_path / "out" / "live.json").read_text())["frames"]
    assert [frame["frame"] for frame in frames] == [0, 1]
    for frame in frames:
        assert "error" in frame or read_map(tmp_path / "out" / f"disparity_{frame['frame']:06d}.pfm").shape == (32, 36)


def test_a_service_that_is_stopped_leaves_its_log(grabbers: None, tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    arguments = ("-o", tmp_path / "out", "--preset=fast", RANGE, "--policy=block", "--frames=1000")
    live("grabber_for_tests:terminated", *arguments)
    assert len(json.loads((tmp_path / "out" / "live.json").read_text())["frames"]) < 1000
    assert signal.getsignal(signal.SIGTERM) == before


def test_maps_are_kept_when_recording_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lfgpu.pipelines.sources.recording.np.savez", full)
    outcome = lfgpu_live("planes", "--grid=3x3", "--size=32x36", "--preset=fast", RANGE, "--record", tmp_path / "film")
    assert outcome.code == 1
    assert outcome.err.splitlines()[-1].endswith("cannot be written: No space left on device.")
    assert not (tmp_path / "film" / "frame_000000").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere"], "does not exist; give one of growing:FOLDER"),
        (["."], "holds no folders"),
        (["grabber_for_tests.py"], "is a file, but no video; give one of"),
        (["grabber_for_tests:nothing"], "yielded no frame"),
        (["grabber_for_tests.py:nothing"], "yielded no frame"),
        (["grabber_for_tests:arrays"], "must yield a LightField first"),
        (["os:system"], "must be a function without arguments that yields frames"),
        (["../somewhere:frames"], "cannot be imported"),
        (["grabber_for_tests:number"], "must be a function without arguments that yields frames"),
        (["grabber_for_tests:missing"], "cannot be imported"),
        (["no_such_module:frames"], "cannot be imported"),
        (["planes", "--policy=queue:x"], "--policy must be latest, block or queue:N"),
        (["planes", "--policy=queue:0"], "--policy must be latest, block or queue:N"),
        (["planes", "--policy=latest:5"], "--policy must be latest, block or queue:N"),
        (["planes", "--preset=paper", "--size=32x32", "--grid=3x3"], "synthesis cannot"),
    ],
)
def test_mistakes_are_one_sentence(grabbers: None, arguments: list[str], sentence: str) -> None:
    outcome = lfgpu_live(*arguments)
    assert outcome.code == 1
    assert sentence in outcome.err
    assert len(outcome.err.splitlines()) == 1


# --- the kernels of the temporal prior, on every device of Warp ---


def _warp_devices() -> tuple[str, ...]:
    return load("warp").devices()


def _texture(height: int, width: int, dx: float, dy: float) -> np.ndarray:
    """A picture [y, x, c] that is (dx, dy) further right and down."""
    y, x = np.mgrid[:height, :width].astype(float)
    x, y = x - dx, y - dy
    waves = [np.sin(0.7 * x + 0.2 * y), np.cos(0.5 * y - 0.3 * x), np.sin(0.4 * x + 0.6 * y + 1)]
    return (0.5 + 0.2 * np.stack(waves, axis=2)).astype(np.float32)


def _found(device: str, image: np.ndarray, last: np.ndarray, fields: list[np.ndarray]) -> tuple[Any, list[Any]]:
    """`same`, and the fields carried along the motion."""
    kernels = load("warp")
    live = kernels.streaming
    size = image.shape[:2]
    motion, same = live.motion(kernels.image(image, device)), kernels.zeros(size, device)
    motion.find(kernels.image(image, device), kernels.image(last, device), tolerance=0.01, same_out=same)
    outs = [kernels.zeros(size, device) for _ in range(4)]
    names = ("past_out", "frames_out", "rate_out", "confidence_out")
    inputs = [kernels.field(field, device) for field in fields]
    motion.carry(*inputs, support=0.1, **dict(zip(names, outs, strict=True)))
    return kernels.numpy(same), [kernels.numpy(out) for out in outs]


@pytest.mark.parametrize("device", _warp_devices())
def test_what_is_known_moves_along(device: str) -> None:
    """The coordinates as maps say where each pixel was."""
    dx, dy = 0.7, -0.4
    y, x = np.mgrid[:40, :48].astype(np.float32)
    fields = [np.zeros_like(x), x, 0.01 * y, y]
    same, (past, frames, rate, confidence) = _found(device, _texture(40, 48, dx, dy), _texture(40, 48, 0, 0), fields)
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(frames[inside], (x - dx)[inside], atol=0.1)
    np.testing.assert_allclose(confidence[inside], (y - dy)[inside], atol=0.1)
    np.testing.assert_allclose(past, rate, atol=1e-6)  # what is expected is the past and its change
    np.testing.assert_allclose(rate, 0.01 * confidence, atol=1e-5)
    assert (same[inside] > 0.99).all()


@pytest.mark.parametrize("device", _warp_devices())
def test_surfaces_are_not_mixed_when_they_move(device: str) -> None:
    past = np.where(np.arange(48) < 24, 0.0, 1.0)[None].repeat(40, axis=0).astype(np.float32)
    zero = np.zeros_like(past)
    _, carried = _found(device, _texture(40, 48, 0.5, 0.2), _texture(40, 48, 0, 0), [past, past, zero, zero])
    assert set(np.unique(carried[0])) == {0.0, 1.0}
    np.testing.assert_array_equal(carried[1], carried[0])

"""Frames from videos, growing folders, shared memory and OpenCV become light fields of the right cameras."""

import sys
import types
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import said
from PIL import Image
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.cli import app, live
from lfgpu.data import LightField
from lfgpu.io import write_hci
from lfgpu.io.ring import RingWriter
from lfgpu.pipelines.sources import SOURCES, Options, feed, open_source, recorded

STREAM: dict[str, Any] = {"config": "fast", "disparity_range": (-1, 1), "device": "cpu", "policy": "block"}
OPTIONS: dict[str, Any] = {"grid": (2, 3), "size": (32, 36), "disparity_range": (-1, 1)}
FRAMES = 4


@cache
def film() -> tuple[LightField, ...]:
    return tuple(lf for lf, _ in zip(scenes.sequence("moving", frames=90, **OPTIONS), range(FRAMES), strict=False))


def write_video(path: Path, pictures: Any) -> None:
    """A video without loss."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    height, width, _ = pictures[0].shape
    coding = {"codec": "ffv1", "pix_fmt_out": "gbrp", "macro_block_size": 1, "ffmpeg_log_level": "error"}
    writer = ffmpeg.write_frames(str(path), (width, height), fps=10, **coding)
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture))
    writer.close()


def all_views(frames: Any) -> list[np.ndarray]:
    found = []
    for frame in frames:
        views = frame[0] if isinstance(frame, tuple) else frame
        found.append(views.views if isinstance(views, LightField) else views)
    return found


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    folder = tmp_path / "videos"
    folder.mkdir()
    for view in range(6):  # camera_9 before camera_10
        write_video(folder / f"camera_{view + 7}.mkv", [lf.views[view] for lf in film()])
    (folder / "notes.txt").write_text("no video")
    return folder


def test_one_video_for_each_camera_of_which_the_shortest_ends(videos: Path) -> None:
    opened = open_source(str(videos), Options(grid=(2, 3)))
    np.testing.assert_array_equal(opened.first.positions, film()[0].positions)
    np.testing.assert_array_equal(all_views(opened.frames), [lf.views for lf in film()])
    assert not opened.is_live
    write_video(videos / "camera_8.mkv", [lf.views[1] for lf in film()[:2]])
    assert len(list(open_source(str(videos)).frames)) == 2
    write_video(videos / "camera_9.mkv", [lf.views[1][:20] for lf in film()])
    with pytest.raises(lfgpu.LightFieldError, match=r"camera_9.mkv has frames of 36 x 20 pixels, but .*camera_7"):
        open_source(str(videos))


@pytest.mark.parametrize("name", ["cam{}/{:03d}.png", "{}/{:03d}.png"])
def test_folders_of_cameras_are_no_frames(tmp_path: Path, name: str) -> None:
    for camera, time in np.ndindex(2, 3):
        file = tmp_path / name.format(camera if "cam" in name else ("left", "right")[camera], time)
        file.parent.mkdir(exist_ok=True)
        Image.fromarray(film()[time].views[camera]).save(file)
    with pytest.raises(lfgpu.LightFieldError, match="has several folders with numbered images"):
        open_source(str(tmp_path))


@pytest.mark.parametrize("names", [("cam_0", "cam_1"), ("left", "right"), ("0", "1")])
def test_a_film_that_is_not_named_as_those_of_cameras_is_asked_about(tmp_path: Path, names: tuple[str, ...]) -> None:
    for k, name in enumerate(names):
        write_video(tmp_path / f"{name}.mkv", [lf.views[k] for lf in film()])
    assert len(open_source(str(tmp_path)).first.views) == 2
    write_video(tmp_path / "preview.mkv", [lf.views[0] for lf in film()])
    with pytest.raises(lfgpu.LightFieldError, match=rf"holds preview\.mkv, .* such as {names[0]}\.mkv: move what is"):
        open_source(str(tmp_path))


def test_cameras_from_a_light_field(videos: Path) -> None:
    like = lfgpu.LightField(film()[0].views, film()[0].positions * [1.5, 1], reference=4)
    first = open_source(str(videos), Options(like=like)).first
    np.testing.assert_array_equal(first.positions, like.positions)
    assert first.reference == 4
    with pytest.raises(lfgpu.LightFieldError, match=r"has 6 views of 32 x 36 pixels, but .* has 5"):
        open_source(str(videos), Options(like=lfgpu.LightField(like.views[:5], like.positions[:5])))
    with pytest.raises(lfgpu.LightFieldError, match="a grid of 3 x 3 has 9"):
        open_source(str(videos), Options(grid=(3, 3)))


def test_a_tiled_video(tmp_path: Path) -> None:
    path = tmp_path / "tiles.mkv"
    tiles = [lf.views.reshape(2, 3, 32, 36, 3).transpose(0, 2, 1, 3, 4).reshape(64, 108, 3) for lf in film()]
    write_video(path, tiles)
    opened = open_source(str(path), Options(grid=(2, 3)))
    np.testing.assert_array_equal(all_views(opened.frames), [lf.views for lf in film()])
    np.testing.assert_array_equal(opened.first.positions, film()[0].positions)
    with pytest.raises(lfgpu.LightFieldError, match="say how many views each of its frames holds"):
        open_source(str(path))
    with pytest.raises(lfgpu.LightFieldError, match="cannot be cut into 5 x 3 views"):
        open_source(str(path), Options(grid=(5, 3)))


# --- folders that grow ---


def test_a_folder_that_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that are there, that come, that come in parts, that are damaged or of other cameras."""
    folder, heard, asked = tmp_path / "in", list[str](), [1]
    folder.mkdir()
    write_hci(film()[0], folder / "frame_9")

    def between_looks(_: float) -> None:
        asked[0] += 1
        match asked[0]:
            case 2:
                write_hci(film()[1], folder / "frame_10")
                (folder / "frame_10" / "input_Cam005.png").rename(tmp_path / "late.png")
                later = folder / "frame_10" / "parameters.cfg"
                later.rename(tmp_path / "late.cfg")
            case 3:
                (tmp_path / "late.png").rename(folder / "frame_10" / "input_Cam005.png")
                (tmp_path / "late.cfg").rename(folder / "frame_10" / "parameters.cfg")
            case 5:
                write_hci(film()[2], folder / "frame_11")
                (folder / "frame_11" / "input_Cam000.png").write_bytes(b"nothing")
                write_hci(scenes.make("planes", grid=(3, 2), size=(32, 36)), folder / "frame_12")
            case 8:
                write_hci(film()[3], folder / "frame_13")
        if asked[0] > 11:
            raise KeyboardInterrupt

    def until_interrupted(frames: Any) -> Any:
        with suppress(KeyboardInterrupt):
            yield from frames

    monkeypatch.setattr("lfgpu.pipelines.sources.folder.time", SimpleNamespace(sleep=between_looks))
    opened = open_source(f"growing:{folder}", Options(say=heard.append))
    assert opened.is_live
    found = all_views(until_interrupted(opened.frames))
    np.testing.assert_array_equal(found, [film()[index].views for index in (0, 1, 3)])
    assert ["frame_11" in heard[0], "frame_12 has other camera positions" in heard[1]] == [True, True]


def test_a_growing_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="is no folder; make it before"):
        open_source(f"growing:{tmp_path / 'nowhere'}")


def test_options_that_a_source_does_not_read_are_refused(tmp_path: Path) -> None:
    write_hci(film()[0], tmp_path / "0")
    with pytest.raises(lfgpu.LightFieldError, match="takes no frame and no like and no size: it is a folder that"):
        open_source(str(tmp_path), Options(like=film()[0], reading={"frame": 1}, scene={"size": (24, 24)}))
    with pytest.raises(lfgpu.LightFieldError, match="takes no pattern: it is a synthetic scene"):
        open_source("moving", Options(reading={"pattern": "{u}.png"}))
    with pytest.raises(lfgpu.LightFieldError, match="takes no like: it is a synthetic scene"):
        open_source("moving", Options(like=film()[0]))


# --- frames that are kept ---


def test_recorded_frames_are_played_again(tmp_path: Path) -> None:
    """With cameras that had no picture, the reference view and the frames that do not fit left out."""
    where = {"geometry": lfgpu.Geometry(500.0, 0.1), "files": tuple(f"{n}.png" for n in range(6))}
    first = lfgpu.LightField(film()[0].views, film()[0].positions, reference=2, **where)
    there = np.array([True, True, True, False, True, True])
    given: list[Any] = [first, film()[1].views, (film()[2].views, there), film()[3].views[:2]]
    given.append((film()[3].views, np.arange(6) != 2))
    passed = list(recorded(iter(given), first, tmp_path / "kept"))
    assert all(one is other for one, other in zip(passed, given, strict=True))
    opened = open_source(str(tmp_path / "kept"))
    assert opened.first.reference == 2
    assert opened.first.geometry == first.geometry
    frames = list(opened.frames)
    want = np.array([lf.views for lf in film()[:3]])
    want[2][~there] = 0
    np.testing.assert_array_equal(all_views(frames), want)
    np.testing.assert_array_equal(frames[2][1], there)


# --- shared memory ---


def test_a_ring(tmp_path: Path) -> None:
    path, heard = tmp_path / "rig", list[str]()
    there = np.array([True] * 5 + [False])
    with RingWriter(path, film()[0].positions, film()[0].size, reference=1) as ring:
        ring.write(film()[0].views)
        opened = open_source(f"ring:{path}", Options(say=heard.append))
        assert opened.first.reference == 1
        np.testing.assert_array_equal(opened.first.positions, film()[0].positions)
        frames = iter(opened.frames)
        next(frames)
        ring.write(film()[1].views, valid=there)
        views, valid = next(frames)
        np.testing.assert_array_equal(views, film()[1].views)
        np.testing.assert_array_equal(valid, there)
        ring.write(film()[2].views)
        ring.write(film()[3].views)
    np.testing.assert_array_equal(all_views(frames), [film()[3].views])
    assert heard == [f"1 frames of {path} were passed over, because newer ones came before they were asked for."]


# --- OpenCV ---


class _Camera:
    """A device as OpenCV shows it: pictures in BGR; None is a picture that does not come."""

    pictures: dict[Any, list[np.ndarray | None]]

    def __init__(self, name: Any) -> None:
        self._pictures = iter(self.pictures.get(name, []))
        self._open, self._now = name in self.pictures, None

    def isOpened(self) -> bool:  # noqa: N802
        return self._open

    def grab(self) -> bool:
        self._now = next(self._pictures, None)
        return self._now is not None

    def retrieve(self) -> tuple[bool, Any]:
        return True, self._now

    def release(self) -> None:
        self._open = False


@pytest.fixture
def opencv(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    module = types.ModuleType("cv2")
    module.VideoCapture = _Camera  # type: ignore[attr-defined]
    module.COLOR_BGR2RGB = 4  # type: ignore[attr-defined]
    module.cvtColor = lambda picture, code: picture[..., ::-1]  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "cv2", module)
    monkeypatch.setattr(_Camera, "pictures", {n: [lf.views[n][..., ::-1] for lf in film()] for n in range(6)}, False)
    return module


def test_cameras_of_opencv(opencv: types.ModuleType) -> None:
    _Camera.pictures[3][2] = None
    opened = open_source("opencv:0, 1,2,3,4,5", Options(grid=(2, 3)))
    assert opened.is_live
    frames = list(opened.frames)
    np.testing.assert_array_equal(frames[0].views, film()[0].views)
    np.testing.assert_array_equal([valid.sum() for _, valid in frames[1:]], [6, 5, 6])
    np.testing.assert_array_equal(frames[2][0][4], film()[2].views[4])
    assert not frames[2][1][3]


def test_cameras_of_opencv_that_cannot_be_used(opencv: types.ModuleType) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="OpenCV cannot open '7' of opencv:0,7"):
        open_source("opencv:0,7")
    _Camera.pictures[1] = [film()[0].views[1][:9]]
    with pytest.raises(
        lfgpu.LightFieldError, match=r"'1' of opencv:0,1 has frames of 36 x 9 pixels, but '0' of .* has"
    ):
        open_source("opencv:0,1")


def test_opencv_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(lfgpu.LightFieldError, match=r"needs cv2, which is not installed; .*\[opencv\]"):
        open_source("opencv:0,1")


# --- the command ---


def test_every_source_is_in_the_help() -> None:
    text = " ".join(CliRunner().invoke(app, ["live", "--help"], env={"COLUMNS": "200"}).output.split())
    for source in SOURCES:
        assert source.form in text


def test_a_scene_that_moves_is_made_before_it_is_played(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.pipelines.sources.scene._SAID_AGAIN", 1e9)  # on a busy machine it takes some seconds
    heard: list[str] = []
    clean = {"size": (24, 24), "noise": 0.0}
    frames = open_source("moving", Options(grid=(2, 2), scene=clean, say=heard.append)).frames
    assert heard == ["Making 24 frames of the scene moving, which then repeat."]
    some = [next(frames) for _ in range(49)]
    assert some[1] is some[25]
    want = list(scenes.sequence("moving", frames=24, grid=(2, 2), size=(24, 24)))[5]
    np.testing.assert_array_equal(some[5].views, want.views)


def test_it_is_said_how_many_frames_of_a_scene_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.pipelines.sources.scene._SAID_AGAIN", -1.0)
    heard: list[str] = []
    open_source("moving", Options(grid=(2, 2), scene={"size": (24, 24)}, most=3, say=heard.append))
    assert heard[0] == "Making 3 frames of the scene moving."
    assert set(heard[1:]) == {f"{n} of 3 frames are made." for n in range(1, 4)}


def test_frames_are_not_faster_than_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that only sleeping moves."""
    now = [0.0]
    clock = types.SimpleNamespace(perf_counter=lambda: now[0], sleep=lambda s: now.__setitem__(0, now[0] + s))
    monkeypatch.setattr("lfgpu.pipelines.sources.feeding.time", clock)
    taken: list[float] = []

    def frames() -> Any:
        for lf in film():
            taken.append(now[0])
            now[0] += 0.31 if len(taken) == 2 else 0.0
            yield lf.views

    with lfgpu.DepthStream(film()[0], **STREAM) as stream:
        feed(stream, frames(), max_fps=10.0)
    np.testing.assert_allclose(taken, [0.0, 0.1, 0.41, 0.51], atol=1e-9)


def test_the_command_records_frames_and_says_that_the_range_is_too_small(videos: Path, tmp_path: Path) -> None:
    arguments = ["live", videos, "--grid=2x3", "--preset=fast", "--disparity-range=-1,0", "--device=cpu"]
    text = " ".join(said(*arguments, f"--record={tmp_path / 'kept'}").split())
    assert f"{FRAMES} of {FRAMES}, 0 dropped, 0 failed" in text
    assert "is too small for the frames" in text
    again = open_source(str(tmp_path / "kept"))
    np.testing.assert_array_equal(all_views(again.frames), [lf.views for lf in film()])


class _Page:
    """A record of the messages to the viewer."""

    url = "http://127.0.0.1/"

    def __init__(self, lf: LightField) -> None:
        self.contents = types.SimpleNamespace(lf=lf)
        self.shown: list[tuple[np.ndarray, np.ndarray]] = []
        self.facts: list[dict[str, Any]] = []
        self.closed = False

    def update(self, disparity: Any, confidence: Any, *, views: Any, **facts: Any) -> None:
        assert confidence.shape == disparity.shape
        self.shown.append((disparity, views))
        self.facts.append(facts)

    def offer(self, **switches: Any) -> None:
        self.switches = switches

    def switch(self, name: str, on: bool) -> None:
        self.switches[name](on)

    def close(self) -> None:
        self.closed = True


def test_the_page_shows_maps_with_their_own_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    pages: list[_Page] = []
    monkeypatch.setattr("lfgpu.viewer.Viewer", lambda lf: pages.append(_Page(lf)) or pages[-1])
    monkeypatch.setattr(live, "_SHOWN_AGAIN", 0.0)
    buffer = film()[0].views.copy()

    def frames() -> Any:
        """From one buffer, as cameras do."""
        for lf in film():
            buffer[:] = lf.views
            yield buffer

    stream = lfgpu.DepthStream(film()[0], prior=None, **STREAM)
    with live.View(film()[0], records=False) as page, stream:
        feed(stream, frames(), tag=page.kept, on_done=partial(page.show, stream))
    (shown,) = pages
    assert shown.switches["record"] is None  # nothing to switch
    assert all(facts["rate"] >= 0 and 0 < facts["latency"] < 600 and facts["dropped"] == 0 for facts in shown.facts)
    assert shown.closed
    for (_, views), lf in zip(shown.shown, film(), strict=True):
        np.testing.assert_array_equal(views, lf.views)
    want = lfgpu.estimate_depth(film()[0], config="fast", disparity_range=(-1, 1), device="cpu").disparity
    np.testing.assert_array_equal(shown.shown[0][0], want)


def test_what_is_switched_on_the_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """After the first frame the stream is paused for two questions, and then nothing is recorded any more."""
    pages: list[_Page] = []
    monkeypatch.setattr("lfgpu.viewer.Viewer", lambda lf: pages.append(_Page(lf)) or pages[-1])
    monkeypatch.setattr("lfgpu.pipelines.sources.feeding._ASKED_AGAIN", 0.0)
    asked: list[int] = []

    def hold() -> bool:
        asked.append(stream.stats()["frames_pushed"])
        if len(asked) == 2:
            pages[0].switch("pause", True)
        if len(asked) == 4:
            assert stream.stats()["frames_done"] == 1  # its map was waited for
            pages[0].switch("record", False)
            pages[0].switch("pause", False)
        return page.pauses

    stream = lfgpu.DepthStream(film()[0], **STREAM)
    with live.View(film()[0], records=True) as page, stream:
        frames = recorded(iter(film()), film()[0], tmp_path, wanted=lambda: page.records)
        feed(stream, frames, hold=hold)
    assert asked[:5] == [0, 1, 1, 1, 2]
    assert [folder.name for folder in tmp_path.iterdir()] == ["frame_000000"]
    assert stream.stats()["frames_done"] == len(film())

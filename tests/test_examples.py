"""The examples run, and what they find is right; those with cameras on stand-ins for drivers that are not here."""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import Rectified, read_rectifier, write_rectified
from lfgpu.data import LightField
from tests.made import masked

FOLDER = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_and_notebook_is_tried() -> None:
    tried = {"first_depth_map", "own_camera_array", "live_stream", "compare_backends", "metric_scale"}
    tried |= {"checkerboard", "opencv_cameras", "gstreamer_appsink", "ros2_node"}  # below
    tried |= {"ring_producer"}  # in tests/io/test_ring.py
    assert {path.stem for path in FOLDER.glob("*.py")} == tried
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {"depth_map"}


@pytest.mark.thorough
def test_the_notebook_runs_and_shows_what_it_says(tmp_path: Path) -> None:
    """In a kernel of Jupyter, from a folder of its own."""
    nbformat = pytest.importorskip("nbformat", reason="nbclient is not installed: pip install 'lfgpu[test]'")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'lfgpu[test]'")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'lfgpu[test]'")
    notebook = nbformat.read(FOLDER / "depth_map.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "it is kept without what it showed once"
    nbclient.NotebookClient(notebook, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    shown = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert [
        next(word for word in ("EPI of row", "Uncertainty", "Prediction error") if word in page) for page in shown
    ] == ["EPI of row", "Uncertainty", "Prediction error"], "the light field, the result, the judge"
    said = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stdout")
    assert "BadPix(0.07)" in said
    assert any("image/png" in output.get("data", {}) for output in outputs), "the refocused picture"
    assert "<html" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_first_depth_map(tmp_path: Path) -> None:
    result = example("first_depth_map").main(out=str(tmp_path / "map.png"), size=(40, 48))
    assert (tmp_path / "map.png").is_file()
    assert result.disparity.shape == (40, 48)


def test_first_depth_map_of_views_with_masks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lf = masked(scenes.make("boxes", grid=(3, 3), size=(40, 48)), np.s_[:, :5, :5])
    np.savez(tmp_path / "masked.npz", views=lf.views, positions=lf.positions, valid=lf.valid)
    result = example("first_depth_map").main(str(tmp_path / "masked.npz"), out=str(tmp_path / "map.png"))
    assert np.isnan(result.disparity).any()
    assert "nan" not in capsys.readouterr().out


def test_own_camera_array() -> None:
    size = (48, 64)
    result = example("own_camera_array").main(size=size)
    lf = scenes.make("planes", grid=(5, 5), size=size)
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
    apart = np.abs(results["warp"].disparity - results["reference"].disparity)
    assert np.quantile(apart, 0.95) < 1e-3


def test_a_map_of_another_tool_gets_the_scale_of_the_light_field(tmp_path: Path) -> None:
    """A map in another unit comes back to the truth, though a fifth of its sure pixels contradict the others."""
    lf = scenes.make("boxes", grid=(5, 5), size=(64, 80))
    truth = lf.truth.disparity
    other = (truth - 3.0) / 0.2
    other[:, :16] += 9.0
    result = lfgpu.estimate_depth(lf, config="accurate")
    result.save(tmp_path / "result.npz")
    np.save(tmp_path / "other.npy", other)
    scaled = example("metric_scale").main(*(str(tmp_path / n) for n in ("result.npz", "other.npy", "scaled.npz")))
    assert np.abs(scaled.disparity - truth)[:, 16:].max() < 0.05
    read = lfgpu.load(tmp_path / "scaled.npz")
    assert isinstance(read, lfgpu.DisparityMap)
    np.testing.assert_allclose(read.depth[:, 16:], lf.geometry.depth(truth)[:, 16:], rtol=0.02)
    with pytest.raises(ValueError, match="shape"):
        example("metric_scale").on_scale(other[1:], result)
    with pytest.raises(ValueError, match="no scale can be fitted"):
        example("metric_scale").on_scale(other, result, sure=1.1)


@pytest.mark.thorough
def test_checkerboard() -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    depth, true = example("checkerboard").main()
    error = np.abs(depth / true - 1)
    assert np.isfinite(error).mean() > 0.85
    assert np.nanmedian(error) < 0.005
    assert np.nanquantile(error, 0.9) < 0.02


class Capture:
    """A stand-in for cv2.VideoCapture: some pictures of one colour, blue first."""

    def __init__(self, source: int) -> None:
        self.left = [np.full((6, 8, 3), (10 * n, 50, source), np.uint8) for n in range(3)]

    def read(self) -> tuple[bool, np.ndarray | None]:
        return (True, self.left.pop(0)) if self.left else (False, None)


@dataclass
class Still:
    """A stand-in for a camera that gives the same picture for ever."""

    picture: np.ndarray | None

    def read(self) -> tuple[bool, np.ndarray | None]:
        return self.picture is not None, self.picture


def test_opencv_cameras() -> None:
    found = list(example("opencv_cameras").frames(sources=(3, 5), capture=Capture))
    assert found
    for views, valid in found:
        assert views.shape == (2, 6, 8, 3)
        for camera, source in ((0, 3), (1, 5)):
            if valid[camera]:
                assert views[camera, 0, 0, :2].tolist() == [source, 50]  # red first
    with pytest.raises(SystemExit, match="gives no picture"):
        next(example("opencv_cameras").frames(capture=lambda _: Still(None)))
    with pytest.raises(SystemExit, match="camera 2 gives no picture"):
        next(example("opencv_cameras").frames(capture=lambda n: Capture(n) if n < 2 else Still(None)))
    sizes = {0: (4, 5, 3), 1: (4, 6, 3)}
    with pytest.raises(SystemExit, match=r"pictures of \[\(4, 5, 3\), \(4, 6, 3\)\]; set them to one size"):
        next(example("opencv_cameras").frames(sources=(0, 1), capture=lambda n: Still(np.zeros(sizes[n], np.uint8))))


def test_gstreamer_appsink(monkeypatch: pytest.MonkeyPatch) -> None:
    module = example("gstreamer_appsink")
    monkeypatch.setattr(module, "SIZE", (4, 5))
    sinks: dict[str, Any] = {}

    class Sink:
        def __init__(self) -> None:
            self.called: dict[str, Any] = {}
            self.sample: Any = None

        def connect(self, signal: str, function: Any, *arguments: Any) -> None:
            self.called[signal] = lambda: function(self, *arguments)

        def emit(self, _: str) -> Any:
            return self.sample

    def play(state: str) -> None:
        if state != "playing":
            return
        for moment in range(2):
            for camera in (1, 0):
                rows = np.zeros((4, 16), np.uint8)  # padded to 4 bytes
                rows[:, :15] = 100 * moment + camera
                data = rows.tobytes()
                buffer = SimpleNamespace(
                    extract_dup=lambda first, size, data=data: data[first : first + size],
                    get_size=lambda data=data: len(data),
                    pts=int(1e9 * (moment / 30 + 0.001 * camera)),
                )
                sink = sinks[f"camera{camera}"]
                sink.sample = SimpleNamespace(get_buffer=lambda buffer=buffer: buffer)
                assert sink.called["new-sample"]() == "ok"
        sinks["camera0"].called["eos"]()

    pipeline = SimpleNamespace(get_by_name=lambda name: sinks.setdefault(name, Sink()), set_state=play)
    texts: list[str] = []
    gst = SimpleNamespace(
        parse_launch=lambda text: texts.append(text) or pipeline,
        State=SimpleNamespace(PLAYING="playing", NULL="null"),
        FlowReturn=SimpleNamespace(OK="ok"),
    )
    found = list(module.frames(sources=("a", "b"), gst=gst))
    assert [views[:, 0, 0, 0].tolist() for views, _ in found] == [[0, 1], [100, 101]]
    assert all(valid.all() for _, valid in found)
    assert "appsink name=camera1" in texts[0]


def stub_of_ros(monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any]) -> SimpleNamespace:
    """As much of rclpy and sensor_msgs as the node uses; subscriptions and what was published."""
    bus = SimpleNamespace(heard={}, published=[])

    class Message:
        def __init__(self, **fields: Any) -> None:
            self.header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
            self.__dict__.update(fields)

    class Image(Message):
        pass

    class CameraInfo(Message):
        pass

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
            return SimpleNamespace(value=parameters.get(name, default))

        def create_publisher(self, *_: Any) -> SimpleNamespace:
            return SimpleNamespace(publish=bus.published.append)

        def create_subscription(self, _: Any, topic: str, function: Any, __: Any) -> None:
            bus.heard[topic] = function

        def get_logger(self) -> Any:
            raise AssertionError("nothing has moved")

    bus.Image, bus.CameraInfo = Image, CameraInfo
    for name, names in {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": 10},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Image": Image, "CameraInfo": CameraInfo},
    }.items():
        module = ModuleType(name)
        module.__dict__.update(names)
        monkeypatch.setitem(sys.modules, name, module)
    return bus


def test_ros2_node(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lf: LightField = scenes.make("planes", grid=(3, 3), size=(48, 60), seed=1)
    write_rectified(Rectified(lf, None, None), tmp_path / "rig")
    topics = [f"/cam{n}/image_raw" for n in range(9)]
    bus = stub_of_ros(monkeypatch, {"rig": str(tmp_path / "rig"), "topics": topics})
    node = example("ros2_node").DepthNode()
    for moment in range(3):
        for camera, topic in enumerate(topics):
            message = bus.Image(height=48, width=60, encoding="rgb8", step=180, data=lf.views[camera].tobytes())
            message.header.stamp.sec, message.header.stamp.nanosec = 5, moment * 33_000_000 + 1000 * camera
            bus.heard[topic](message)
    node.grouper.close()
    node.thread.join()
    images = [message for message in bus.published if isinstance(message, bus.Image)]
    infos = [message for message in bus.published if isinstance(message, bus.CameraInfo)]
    assert len(images) == len(infos) >= 1
    depth = np.frombuffer(images[0].data, np.float32).reshape(images[0].height, images[0].width)
    result = lfgpu.estimate_depth(lf, config="fast")
    assert result.depth is not None
    assert np.median(np.abs(depth / result.depth - 1)) < 0.01
    assert (images[0].encoding, images[0].step, images[0].header.stamp.sec) == ("32FC1", 240, 5)
    assert len(infos[0].k) == 9
    assert len(infos[0].p) == 12
    assert read_rectifier(tmp_path / "rig").geometry == lf.geometry

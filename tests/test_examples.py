"""The examples run, and what they find is right."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import lfgpu
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
    tried = {"first_depth_map", "own_camera_array", "live_stream", "compare_backends", "metric_scale"}
    tried |= {"checkerboard", "opencv_cameras", "gstreamer_appsink", "ros2_node"}  # in test_camera_examples.py
    tried |= {"ring_producer"}  # in tests/io/test_ring.py
    assert {path.stem for path in FOLDER.glob("*.py")} == tried


def test_every_notebook_is_tried() -> None:
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
    lf = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    valid = np.ones(lf.views.shape[:3], bool)
    valid[:, :5, :5] = False
    np.savez(tmp_path / "masked.npz", views=lf.views, positions=lf.positions, valid=valid)
    result = example("first_depth_map").main(str(tmp_path / "masked.npz"), out=str(tmp_path / "map.png"))
    assert np.isnan(result.disparity).any()
    assert "nan" not in capsys.readouterr().out


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
    apart = np.abs(results["warp"].disparity - results["reference"].disparity)
    assert np.quantile(apart, 0.95) < 1e-3


def test_a_map_of_another_tool_gets_the_scale_of_the_light_field(tmp_path: Path) -> None:
    """A map in another unit comes back to the truth, though a fifth of its sure pixels contradict the others."""
    lf = scenes.make("boxes", grid=(5, 5), size=(64, 80))
    assert lf.truth is not None
    truth = lf.truth.disparity
    other = (truth - 3.0) / 0.2
    other[:, :16] += 9.0
    result = lfgpu.estimate_depth(lf)
    result.save(tmp_path / "result.npz")
    np.save(tmp_path / "other.npy", other)
    scaled = example("metric_scale").main(*(str(tmp_path / n) for n in ("result.npz", "other.npy", "scaled.npz")))
    assert np.abs(scaled.disparity - truth)[:, 16:].max() < 0.05
    read = lfgpu.load(tmp_path / "scaled.npz")
    assert isinstance(read, lfgpu.DisparityMap)
    assert lf.geometry is not None
    np.testing.assert_allclose(read.depth[:, 16:], lf.geometry.depth(truth)[:, 16:], rtol=0.02)
    with pytest.raises(ValueError, match="shape"):
        example("metric_scale").on_scale(other[1:], result)
    with pytest.raises(ValueError, match="no scale can be fitted"):
        example("metric_scale").on_scale(other, result, sure=1.1)

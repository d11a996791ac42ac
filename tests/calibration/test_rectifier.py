"""Raw frames are rectified on the device: as `rectify` does it, before an estimate, and in streams."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.calibration import Disturbed, Misalignment, Rectified, disturb, read_rectifier, rectify, write_rectified
from lfgpu.calibration.formats import Calibration
from lfgpu.cli import app
from lfgpu.contract import Device
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.pipelines.sources import Options, open_source, recorded

RANGE = (-2.0, 2.0)
WRONG = Misalignment(shift=2, roll=0.5, scale=0.01, distortion=0.2, gain=0.1, vignetting=0.1)


@cache
def disturbed() -> Disturbed:
    """Record with a rig of wrong cameras; calibrated exactly, so that only the tones are not known."""
    return disturb(scenes.make("boxes", grid=(3, 3), size=(96, 112), seed=1, noise=0.004), WRONG, seed=3)


@cache
def rectified() -> Rectified:
    calibration = Calibration(disturbed().cameras, "rig", "lfgpu")
    return rectify(disturbed().light_field, calibration=calibration, tones=True, disparity_range=RANGE)


@cache
def rectifier() -> Rectifier:
    return rectified().rectifier()


def raw() -> LightField:
    return rectifier().pictures(disturbed().light_field.views)


def other_frame() -> np.ndarray:
    """The same cameras before another scene: everything mirrored, which the rectifier need not know."""
    return np.ascontiguousarray(raw().views[:, ::-1])


def test_frames_are_rectified_as_rectify_does_it() -> None:
    want = rectified()
    assert want.refinement is not None
    assert want.refinement.kept
    found = rectifier().rectified(raw(), Device(load("warp"), "cpu"))
    seen = np.ones(found.views.shape[:3], bool) if found.valid is None else found.valid
    inner = seen & (
        np.pad(seen, ((0, 0), (3, 3), (3, 3)))[:, 6:, 6:] & np.pad(seen, ((0, 0), (3, 3), (3, 3)))[:, :-6, :-6]
    )
    off = (found.views.astype(float) - want.light_field.views)[inner] / 255
    before = (raw().views.astype(float) - want.light_field.views)[inner] / 255
    assert np.sqrt((before**2).mean()) > 0.05
    assert np.sqrt((off**2).mean()) < 0.012  # cubic convolution is not quite the spline
    assert found.geometry == want.light_field.geometry
    np.testing.assert_array_equal(found.positions, want.light_field.positions)


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibration", "refined"])
def test_what_rectify_wrote_is_a_rectifier(calibrated: bool, tmp_path: Path) -> None:
    made = rectified()
    assert made.rig is not None
    assert made.refinement is not None
    if calibrated:  # cameras off their plane
        made = replace(made, rig=replace(made.rig, ahead=np.linspace(-0.1, 0.1, 9), corrected_at=5.0))
    else:
        turned = np.tile(np.eye(3), (9, 1, 1))
        turned[:, 0, 2] = np.arange(9)
        made = replace(made, rig=None, refinement=replace(made.refinement, homographies=turned))
    write_rectified(made, tmp_path / "out")
    found, want = read_rectifier(tmp_path / "out"), made.rectifier()
    if not calibrated:  # brightness falls off with the distance from the middle of the picture as it was recorded
        y, x = np.mgrid[:96, :112]
        from_middle = (x + 8 - 111 / 2) ** 2 + (y - 95 / 2) ** 2
        np.testing.assert_allclose(want.squared_radius[8], from_middle / (56**2 + 48**2), rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.places, want.places, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found.tones, want.tones, rtol=1e-9)
    np.testing.assert_allclose(found.squared_radius, want.squared_radius, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.positions, want.positions, rtol=0, atol=1e-9)
    assert found.valid is not None
    np.testing.assert_array_equal(found.valid, want.valid)
    assert found.reference == want.reference


@pytest.mark.parametrize("backend", ["warp", "taichi", "reference"])
def test_a_pipeline_takes_raw_pictures(backend: str) -> None:
    kernels = load(backend)
    small = replace(
        rectifier(),
        places=rectifier().places[:, :40, :44],
        squared_radius=rectifier().squared_radius[:, :40, :44],
        valid=None if rectifier().valid is None else rectifier().valid[:, :40, :44],
    )
    first, second = raw().views[:, :40, :44], other_frame()[:, :40, :44]
    options = {"config": "fast", "disparity_range": RANGE, "backend": backend, "device": "cpu"}
    pipeline = lfgpu.DepthPipeline(small.pictures(first), rectifier=small, **options)
    for frame in (first, second):
        pipeline.upload(frame)
        pipeline.run()
        lf = small.rectified(small.pictures(frame), Device(kernels, "cpu"))
        alone = lfgpu.DepthPipeline(lf, measured=pipeline.measured, **{**options, "disparity_range": None})
        alone.run()
        # The reference keeps what lies between whole numbers.
        close = {"rtol": 0, "atol": 0.05 if backend == "reference" else 1e-6}
        off = np.abs(pipeline.disparity() - alone.disparity())
        assert np.nanmedian(off) <= close["atol"]
        if backend != "reference":
            np.testing.assert_allclose(pipeline.disparity(), alone.disparity(), **close)
    assert pipeline.estimate().timings["rectify"] > 0


def test_a_stream_takes_raw_pictures_and_other_tones() -> None:
    options = {"config": "fast", "disparity_range": RANGE, "device": "cpu"}
    with lfgpu.DepthStream(raw(), rectifier=rectifier(), policy="block", prior=None, **options) as stream:
        found = [stream.push(frame).numpy() for frame in (raw().views, other_frame())]
        stream.set_tones(rectifier().tones * np.array([2.0, 1.0, 2.0])[:, None])
        darker = stream.push(raw().views).numpy()
        assert stream.rectifier is not None
        assert stream.rectifier.tones[0, 0, 0] == 2 * rectifier().tones[0, 0, 0]
        measured = stream.measured
    pipeline = lfgpu.DepthPipeline(raw(), rectifier=rectifier(), measured=measured, config="fast", device="cpu")
    for frame, disparity in zip((raw().views, other_frame()), found, strict=True):
        pipeline.upload(frame)
        pipeline.run()
        np.testing.assert_allclose(disparity, pipeline.disparity(), rtol=0, atol=1e-5)
    assert np.nanmax(np.abs(darker - found[0])) > 0


def test_wrong_pictures_and_rectifiers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match=r"pictures must be \[9, 96, 112, 3\]"):
        rectifier().pictures(raw().views[:4])
    with pytest.raises(LightFieldError, match="nothing that camera 2 shows"):
        replace(rectifier(), places=np.where(np.arange(9)[:, None, None, None] == 2, np.nan, rectifier().places))
    with pytest.raises(LightFieldError, match=r"holds no rectified\.npz"):
        read_rectifier(tmp_path)
    with pytest.raises(LightFieldError, match="tones of the rectifier"):
        replace(rectifier(), tones=rectifier().tones[:4])
    options = {"config": "fast", "disparity_range": RANGE, "device": "cpu"}
    with (
        lfgpu.DepthStream(rectified().light_field, **options) as stream,
        pytest.raises(LightFieldError, match="no rectifier"),
    ):
        stream.set_tones(rectifier().tones)


def test_sources_of_raw_pictures(tmp_path: Path) -> None:
    """Folders of pictures, one of each camera, and frames that were kept, in which a camera may be missing."""
    for frame, count in enumerate((9, 9, 8)):
        folder = tmp_path / "frames" / f"frame_{frame}"
        folder.mkdir(parents=True)
        for n, view in enumerate(raw().views[:count]):
            Image.fromarray(view).save(folder / f"camera_{n}.png")
    opened = open_source(str(tmp_path / "frames"), Options(rectifier=rectifier()))
    np.testing.assert_array_equal(opened.first.positions, rectifier().positions)
    np.testing.assert_array_equal(opened.first.views, raw().views)
    next(opened.frames)
    np.testing.assert_array_equal(next(opened.frames).views, raw().views)
    with pytest.raises(LightFieldError, match=r"frame_2 holds 8 pictures, but .* has 9 cameras"):
        next(opened.frames)
    there = np.arange(9) != 7
    list(recorded(iter([raw().views, (raw().views, there)]), opened.first, tmp_path / "kept"))
    again = open_source(str(tmp_path / "kept"), Options(rectifier=rectifier()))
    np.testing.assert_array_equal(again.first.views, raw().views)
    _, (views, valid) = again.frames
    np.testing.assert_array_equal(valid, there)
    np.testing.assert_array_equal(views[there], raw().views[there])


def test_tones_of_a_closed_stream() -> None:
    """A watch may still look when a stream ends and its memory is returned."""
    stream = lfgpu.DepthStream(raw(), rectifier=rectifier(), config="fast", disparity_range=RANGE, device="cpu")
    stream.close()
    tones = 1.25 * rectifier().tones
    stream.set_tones(tones)
    assert stream.rectifier is not None
    np.testing.assert_array_equal(stream.rectifier.tones, tones)


def test_live_takes_raw_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_rectified(rectified(), tmp_path / "rig")
    for frame in range(2):
        folder = tmp_path / "frames" / f"frame_{frame}"
        folder.mkdir(parents=True)
        for n, view in enumerate(raw().views):
            Image.fromarray(view).save(folder / f"camera_{n}.png")
    (tmp_path / "raw_grabber_for_tests.py").write_text(
        "import numpy as np\nfrom PIL import Image\nfrom pathlib import Path\n"
        "def frames():\n"
        "    files = sorted(Path('frames/frame_0').iterdir())\n"
        "    yield np.stack([np.asarray(Image.open(file)) for file in files])\n"
    )
    monkeypatch.chdir(tmp_path)
    options = ["--rectify", "rig", "--preset=fast", "--disparity-range=-2,2", "--device=cpu", "--cold"]
    for source in ("frames", "raw_grabber_for_tests:frames"):
        outcome = CliRunner().invoke(app, ["live", source, "-o", "out", *options])
        assert outcome.exit_code == 0, outcome.output
        found = read_map(tmp_path / "out" / "disparity_000000.pfm")
        with lfgpu.DepthStream(
            raw(), rectifier=rectifier(), config="fast", disparity_range=RANGE, device="cpu", prior=None
        ) as stream:
            want = stream.push(raw().views).numpy()
        assert np.nanmean(np.abs(found - want)) < 0.01  # the map of the frame, from a rig that was written as pictures
    outcome = CliRunner().invoke(app, ["live", "frames", "--rectify", "frames", "--device=cpu"])
    assert outcome.exit_code == 1
    assert "rectified.npz" in outcome.output
    outcome = CliRunner().invoke(app, ["live", "frames", "--rectify", "rig", "--like", "rig", "--device=cpu"])
    assert outcome.exit_code == 2
    assert "--like" in outcome.output

"""Cameras made worse on purpose, raw frames that are rectified on the device, and depth in the original picture."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu as command, refused
from PIL import Image

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.calibration import (
    Camera,
    Disturbed,
    Misalignment,
    Rectified,
    disturb,
    read_rectifier,
    rectify,
    write_cameras,
    write_rectified,
)
from lfgpu.calibration.cameras import of_quaternion, turned
from lfgpu.calibration.formats import Calibration, read_toml
from lfgpu.calibration.misalign import displacements
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.calibration.resample import pixels
from lfgpu.contract import Device
from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.pipelines.sources import Options, open_source, recorded
from tests.made import thorough


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(96, 112), seed=1)


def test_ideal_cameras_see_what_the_geometry_says(boxes: LightField) -> None:
    """A point of the reference's map, projected into each camera, is where its disparity puts it."""
    d = boxes.truth.disparity
    here = boxes.positions[boxes.reference_index]
    points = boxes.geometry.points(d, position=(float(here[0]), float(here[1])))
    y, x = np.mgrid[: d.shape[0], : d.shape[1]]
    for camera, (du, dv) in zip(ideal_cameras(boxes), boxes.offsets, strict=True):
        seen = camera.project(points + camera.translation)
        np.testing.assert_allclose(seen[..., 0], x - d * du, atol=1e-4)
        np.testing.assert_allclose(seen[..., 1], y - d * dv, atol=1e-4)


def test_a_turn_moves_the_picture_by_as_many_pixels(boxes: LightField) -> None:
    found = disturb(boxes, Misalignment(shift=1.0), seed=2)
    explained = lfgpu.explain(found.light_field, boxes.truth.disparity)  # type: ignore[union-attr]
    ideal = ideal_cameras(boxes)
    middle = np.array([(112 - 1) / 2, (96 - 1) / 2])
    for n, (right, wrong) in enumerate(zip(ideal, found.cameras, strict=True)):
        ray = right.rays(middle) @ np.asarray(wrong.rotation).T
        moved = wrong.project(ray) - middle
        if n == boxes.reference_index:
            np.testing.assert_allclose(moved, 0, atol=1e-9)
        else:
            assert 0.05 < np.hypot(*moved) < 4
    assert explained.misalignment > 0.3


def test_gain_seed_and_reference_are_those_that_are_told(boxes: LightField) -> None:
    found = disturb(boxes, Misalignment(gain=0.1, offset=0.05), seed=4)
    for n, view in enumerate(found.light_field.views):
        want = np.clip(np.rint(boxes.views[n] * found.gain[n] + 255 * found.offset[n]), 0, 255)
        assert np.abs(view - want).max() <= 1
    assert np.abs(found.gain - 1).max() > 0.1
    assert np.abs(found.offset).max() > 0.05
    how = Misalignment(shift=0.5, roll=0.1, scale=0.01, distortion=0.05, gain=0.1, offset=0.02, vignetting=0.3)
    once, again, other = (disturb(boxes, how, seed=seed).light_field.views for seed in (1, 1, 2))
    np.testing.assert_array_equal(once, again)
    assert (once != other).any()
    np.testing.assert_array_equal(once[boxes.reference_index], boxes.views[boxes.reference_index])


def test_cameras_that_stand_elsewhere_see_from_there() -> None:
    moved = displacements(4, 3, 0.3, seed=5)
    assert (moved[3] == 0).all()
    views = scenes.make("planes", grid=(2, 2), size=(64, 64), displaced=moved).views
    nominal = scenes.make("planes", grid=(2, 2), size=(64, 64)).views
    np.testing.assert_array_equal(views[3], nominal[3])
    assert all((views[n] != nominal[n]).any() for n in range(3))
    with pytest.raises(LightFieldError, match="displaced must be 4 finite pairs"):
        scenes.make("planes", grid=(2, 2), size=(64, 64), displaced=moved[:2])


def test_the_command_writes_both_calibrations(tmp_path: Path) -> None:
    out = tmp_path / "lf"
    wrong = "--misalign=shift=1,position=0.05,gain=0.1"
    run = command("scene", "boxes", "-o", out, "--grid=3x3", "--size=48x64", "--seed=4", wrong)
    assert run.code == 0, run.err
    lf = lfgpu.read(out)
    true, calibrated = read_toml(out / "cameras_true.toml"), read_toml(out / "cameras.toml")
    assert [camera.name for camera in true] == [f"input_Cam{n:03d}.png" for n in range(9)]
    assert lf.truth is not None
    baseline = lf.geometry.baseline_m  # type: ignore[union-attr]
    gaps = [np.linalg.norm(a.centre - b.centre) / baseline for a, b in zip(true, calibrated, strict=True)]
    assert 0 < max(gaps) < 0.1
    refused(command("scene", "boxes", "-o", out, "--misalign", "wobble=1"), "misalignment must be NAME=NUMBER")
    with pytest.raises(LightFieldError, match="shift must be a number from 0 to 1000"):
        Misalignment(shift=-1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rotation": np.diag([1.0, -1.0, 1.0])}, "mirrors"),
        ({"rotation": 2 * np.eye(3)}, "orthonormal"),
        ({"distortion": (0.1,)}, "found 1"),
        ({"model": "pinhol"}, "must be one of"),
        ({"focal_length": (0.0, 1.0)}, "positive"),
        ({"translation": (np.nan, 0, 0)}, "finite"),
    ],
)
def test_cameras_that_cannot_be_are_refused(change: dict, words: str) -> None:
    with pytest.raises(LightFieldError, match=words):
        Camera(**{"size": (4, 4), "focal_length": (5.0, 5.0), "principal_point": (1.5, 1.5), **change})


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("pinhole", ()), ("pinhole", (-0.2, 0.1, 0.001, -0.002, 0.05)), ("fisheye", (0.1, -0.02, 0.01, 0.003))],
)
def test_lenses_are_those_of_opencv(model: str, distortion: tuple[float, ...], rng: np.random.Generator) -> None:
    camera = Camera((480, 640), (500, 510), (310, 230), distortion, model, turned((0.1, -0.2, 0.3)), (0.1, 0.2, 0.3))
    pixels = rng.uniform(0, 480, (100, 2))
    np.testing.assert_allclose(camera.project(camera.rays(pixels)), pixels, atol=1e-9)
    cv2 = pytest.importorskip("cv2")
    points = rng.uniform(-1, 1, (50, 3)) + np.array([0, 0, 4])
    lens = np.array(distortion) if distortion else None
    turn, shift = np.array([0.1, -0.2, 0.3]), np.asarray(camera.translation)
    if model == "fisheye":
        expected = cv2.fisheye.projectPoints(points[None], turn, shift, camera.matrix, lens)[0][0]
    else:
        expected = cv2.projectPoints(points, turn, shift, camera.matrix, lens)[0][:, 0]
    np.testing.assert_allclose(camera.project(points @ np.asarray(camera.rotation).T + shift), expected, atol=1e-9)


def test_quaternions_turn_as_vectors_do() -> None:
    np.testing.assert_allclose(of_quaternion(np.cos(0.15), 0, 0, np.sin(0.15)), turned((0, 0, 0.3)), atol=1e-12)


SIZE = (60, 80)
NORMAL, OFFSET = np.array([0.1, -0.2, 1.0]), 2.0  # the plane of points X with NORMAL X = OFFSET, in the world


def rig(rng: np.random.Generator, *, ahead: float) -> tuple[list[Camera], LightField]:
    """Nine cameras that are turned a little, with lenses, about a plane, and what they recorded."""
    cameras = []
    for n in range(9):
        rotation = turned(0.02 * rng.normal(size=3))
        translation = -rotation @ np.array([0.05 * (n % 3), 0.05 * (n // 3), ahead * rng.normal()])
        lens = (-0.1, 0.02, 0.001, -0.001)
        cameras.append(
            Camera(SIZE, (90.0, 91.0), (40.0, 29.0), lens, "pinhole", rotation, translation, name=f"camera {n}")
        )
    views = rng.integers(0, 255, (9, *SIZE, 1)).astype(np.uint8)
    return cameras, LightField(views, np.stack([np.arange(9), np.zeros(9)], 1), name="rig")


def depth_of_the_plane(camera: Camera) -> np.ndarray:
    """Return the depth of the plane along the camera's own axis."""
    rays = camera.rays(pixels(*SIZE)) @ np.asarray(camera.rotation)
    return (OFFSET - NORMAL @ camera.centre) / (rays @ NORMAL)


@pytest.mark.parametrize(("ahead", "close"), [(0.0, 0.004), (0.004, 0.006)])
@pytest.mark.parametrize("index", [4, 0])
def test_a_plane_is_found_in_the_picture_as_it_was(ahead: float, close: float, index: int) -> None:
    cameras, pictures = rig(np.random.default_rng(0), ahead=ahead)
    found = rectify(pictures, calibration=Calibration(tuple(cameras), "rig", "lfgpu"), depths=(1.5, 2.5))
    lf, known = found.light_field, found.rig
    # The true map of a rectified view: where its rays meet the plane, seen from the common frame.
    geometry = known.geometry
    assert geometry.principal_point is not None
    place = lf.positions[index]
    shift = place * geometry.baseline_m * geometry.focal_length_px / geometry.focus_distance_m
    plane = (pixels(*SIZE) - geometry.principal_point - shift) / geometry.focal_length_px
    rays = np.concatenate([plane, np.ones((*SIZE, 1))], -1) @ known.rotation
    centre = cameras[index].centre - known.ahead[index] * known.rotation[2]
    true = geometry.disparity((OFFSET - NORMAL @ centre) / (rays @ NORMAL)).astype(np.float32)
    true[:, :5] = np.nan
    result = DisparityMap(true, position=(float(place[0]), float(place[1])))
    depth = found.original_depth(result)
    there = np.isfinite(depth)
    assert 0.6 < there.mean() < 0.97
    np.testing.assert_allclose(depth[there], depth_of_the_plane(cameras[index])[there], rtol=close)
    assert abs(np.median(depth[there] / depth_of_the_plane(cameras[index])[there]) - 1) < 5e-4


def test_depths_are_in_the_unit_of_the_calibration(rng: np.random.Generator, tmp_path: Path) -> None:
    cameras, pictures = rig(rng, ahead=0.001)
    far = [replace(camera, translation=1000 * np.asarray(camera.translation)) for camera in cameras]
    write_cameras(far, tmp_path / "cameras.toml")
    found = rectify(pictures, calibration=tmp_path / "cameras.toml", unit="mm", depths=(1500, 2500))
    want = rectify(pictures, calibration=Calibration(tuple(cameras), "rig", "lfgpu"), depths=(1.5, 2.5))
    assert found.disparity_range == pytest.approx(want.disparity_range)
    assert found.rig.corrected_at == pytest.approx(want.rig.corrected_at)


RANGE = (-2.0, 2.0)
FAST = {"config": "fast", "disparity_range": RANGE, "device": "cpu"}
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
    assert want.refinement.kept
    found = rectifier().rectified(raw(), Device(load("warp"), "cpu"))
    seen = np.ones(found.views.shape[:3], bool) if found.valid is None else found.valid
    around = np.pad(seen, ((0, 0), (3, 3), (3, 3)))
    inner = seen & around[:, 6:, 6:] & around[:, :-6, :-6]
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


@pytest.mark.parametrize("backend", ["warp", *map(thorough, ("taichi", "reference"))])
def test_a_pipeline_takes_raw_pictures(backend: str) -> None:
    kernels = load(backend)
    parts = {name: getattr(rectifier(), name)[:, :40, :44] for name in ("places", "squared_radius", "valid")}
    small = replace(rectifier(), **parts)
    first, second = raw().views[:, :40, :44], other_frame()[:, :40, :44]
    options = {**FAST, "backend": backend}
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
    with lfgpu.DepthStream(raw(), rectifier=rectifier(), policy="block", prior=None, **FAST) as stream:
        found = [stream.push(frame).numpy() for frame in (raw().views, other_frame())]
        stream.set_tones(rectifier().tones * np.array([2.0, 1.0, 2.0])[:, None])
        darker = stream.push(raw().views).numpy()
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
    map_ = DisparityMap(np.zeros((96, 112), np.float32))
    with pytest.raises(LightFieldError, match="was not rectified"):
        replace(rectified(), rig=None).original_depth(map_)
    with pytest.raises(LightFieldError, match="the map must be of"):
        rectified().original_depth(replace(map_, disparity=map_.disparity[:3]))
    with (
        lfgpu.DepthStream(rectified().light_field, **FAST) as stream,
        pytest.raises(LightFieldError, match="no rectifier"),
    ):
        stream.set_tones(rectifier().tones)


def write_frames(folder: Path, *counts: int) -> None:
    """A folder for each frame, with so many pictures of cameras."""
    for frame, count in enumerate(counts):
        (folder / f"frame_{frame}").mkdir(parents=True)
        for n, view in enumerate(raw().views[:count]):
            Image.fromarray(view).save(folder / f"frame_{frame}" / f"camera_{n}.png")


def test_sources_of_raw_pictures(tmp_path: Path) -> None:
    """Folders of pictures, one of each camera, and frames that were kept, in which a camera may be missing."""
    write_frames(tmp_path / "frames", 9, 9, 8)
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
    stream = lfgpu.DepthStream(raw(), rectifier=rectifier(), **FAST)
    stream.close()
    tones = 1.25 * rectifier().tones
    stream.set_tones(tones)
    np.testing.assert_array_equal(stream.rectifier.tones, tones)


def test_live_takes_raw_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_rectified(rectified(), tmp_path / "rig")
    write_frames(tmp_path / "frames", 9, 9)
    (tmp_path / "raw_grabber_for_tests.py").write_text(
        "import numpy as np\nfrom PIL import Image\nfrom pathlib import Path\n"
        "def frames():\n"
        "    files = sorted(Path('frames/frame_0').iterdir())\n"
        "    yield np.stack([np.asarray(Image.open(file)) for file in files])\n"
    )
    monkeypatch.chdir(tmp_path)
    options = ["--rectify", "rig", "--preset=fast", "--disparity-range=-2,2", "--device=cpu", "--cold"]
    with lfgpu.DepthStream(raw(), rectifier=rectifier(), prior=None, **FAST) as stream:
        want = stream.push(raw().views).numpy()
    for source in ("frames", "raw_grabber_for_tests:frames"):
        outcome = command("live", source, "-o", "out", *options)
        assert outcome.code == 0, outcome.err
        found = read_map(tmp_path / "out" / "disparity_000000.pfm")
        assert np.nanmean(np.abs(found - want)) < 0.01  # the map of the frame, from a rig that was written as pictures
    refused(command("live", "frames", "--rectify", "frames", "--device=cpu"), "rectified.npz")
    outcome = command("live", "frames", "--rectify", "rig", "--like", "rig", "--device=cpu")
    assert (outcome.code, "--like" in outcome.err) == (2, True)

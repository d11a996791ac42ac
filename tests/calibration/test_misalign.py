"""Cameras made worse on purpose: what is drawn is what is recorded, and both calibrations say so."""

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.calibration.cameras import Camera, of_quaternion, turned
from lfgpu.calibration.formats import read_toml
from lfgpu.calibration.misalign import Misalignment, displacements, disturb
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(96, 112), seed=1)


def test_ideal_cameras_see_what_the_geometry_says(boxes: LightField) -> None:
    """A point of the reference's map, projected into each camera, is where its disparity puts it."""
    assert boxes.truth is not None
    assert boxes.geometry is not None
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


def test_gain_and_offset_are_those_that_are_told(boxes: LightField) -> None:
    found = disturb(boxes, Misalignment(gain=0.1, offset=0.05), seed=4)
    for n, view in enumerate(found.light_field.views):
        want = np.clip(np.rint(boxes.views[n] * found.gain[n] + 255 * found.offset[n]), 0, 255)
        assert np.abs(view - want).max() <= 1
    assert np.abs(found.gain - 1).max() > 0.1
    assert np.abs(found.offset).max() > 0.05


def test_the_seed_decides_and_the_reference_stays(boxes: LightField) -> None:
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


def test_the_command_writes_both_calibrations(tmp_path) -> None:
    out = tmp_path / "lf"
    run = CliRunner().invoke(
        app,
        f"scene boxes -o {out} --grid 3x3 --size 48x64 --seed 4 --misalign shift=1,position=0.05,gain=0.1".split(),
    )
    assert run.exit_code == 0, run.output
    lf = lfgpu.read(out)
    true, calibrated = read_toml(out / "cameras_true.toml"), read_toml(out / "cameras.toml")
    assert [camera.name for camera in true] == [f"input_Cam{n:03d}.png" for n in range(9)]
    assert lf.truth is not None
    baseline = lf.geometry.baseline_m  # type: ignore[union-attr]
    gaps = [np.linalg.norm(a.centre - b.centre) / baseline for a, b in zip(true, calibrated, strict=True)]
    assert 0 < max(gaps) < 0.1
    again = CliRunner().invoke(app, ["scene", "boxes", "-o", str(out), "--misalign", "wobble=1"])
    assert again.exit_code == 1
    assert "misalignment must be NAME=NUMBER" in again.stderr
    with pytest.raises(LightFieldError, match="shift must be a number from 0 on"):
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

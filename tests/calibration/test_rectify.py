"""Parallel cameras from calibrated ones, and from what views show: back to what an undisturbed rig records."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu as command, refused
from disturbed import explained
from PIL import Image

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import (
    Camera,
    Misalignment,
    disturb,
    equalise,
    fit_rig,
    rectify,
    refine,
    write_cameras,
    write_rectified,
)
from lfgpu.calibration.cameras import turned
from lfgpu.calibration.formats import Calibration
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_description


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(128, 144), seed=1, noise=0.004)


def inner(views: np.ndarray) -> np.ndarray:
    return views[..., 12:-12, 12:-12, :].astype(float) / 255


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(((inner(a) - inner(b)) ** 2).mean()))


def known(cameras: tuple[Camera, ...], **fields: object) -> Calibration:
    return Calibration(cameras, "rig", "lfgpu", **fields)  # type: ignore[arg-type]


def test_a_true_calibration_undoes_what_the_cameras_did(boxes: LightField) -> None:
    wrong = disturb(boxes, Misalignment(shift=2, roll=0.5, scale=0.01, distortion=0.2), seed=3)
    found = rectify(wrong.light_field, calibration=known(wrong.cameras)).light_field
    assert rms(wrong.light_field.views, boxes.views) > 0.05
    # Focal lengths are averaged: compare with the ideal views at the common one.
    scale = found.geometry.focal_length_px / boxes.geometry.focal_length_px
    assert abs(scale - 1) < 0.01
    judged = explained(found)
    assert judged.misalignment < 0.03
    assert judged.findings == ()
    assert not found.valid.all()


def test_the_geometry_is_in_metres(boxes: LightField) -> None:
    """Of ideal cameras the rig is the light field's own geometry."""
    world = turned((0.3, -0.2, 0.5))  # any frame of the world
    moved = [replace(camera, rotation=np.asarray(camera.rotation) @ world) for camera in ideal_cameras(boxes)]
    rig = fit_rig(moved)
    assert rig.geometry.baseline_m == pytest.approx(boxes.geometry.baseline_m, rel=1e-6)
    assert rig.geometry.focal_length_px == pytest.approx(boxes.geometry.focal_length_px, rel=1e-6)
    np.testing.assert_allclose(rig.positions, boxes.offsets, atol=1e-6)
    np.testing.assert_allclose(rig.ahead, 0, atol=1e-9)
    assert rig.notes == ()
    point = np.array([[70.0, 60.0]])
    for depth in (4.5, 7.0):
        d = rig.geometry.disparity(depth)
        rays = [rig.places(n, point - d * rig.positions[n]) for n in range(9)]
        worlds = []
        for camera, place in zip(moved, rays, strict=True):
            ray = camera.rays(place)[0] @ np.asarray(camera.rotation)
            worlds.append(camera.centre + ray * depth / (ray @ rig.rotation[2]))
        np.testing.assert_allclose(worlds, np.tile(worlds[0], (9, 1)), atol=1e-6)


def test_cameras_off_the_plane_are_right_at_one_depth() -> None:
    """What two cameras record of a point at that depth is where rectified pixels say, although they stand apart."""
    cameras = [
        Camera((100, 120), (200, 200), (59.5, 49.5), translation=(-0.1 * u, -0.1 * v, 0.02 * (-1) ** (u + v)))
        for v in range(3)
        for u in range(3)
    ]
    rig = fit_rig(cameras, depths=(2.0, 4.0), reference=4)
    assert rig.corrected_at == pytest.approx(8 / 3)
    assert "off their plane" in rig.notes[0]
    plane = float(np.median([camera.centre @ rig.rotation[2] for camera in cameras]))
    across = (rig.rotation @ cameras[4].centre)[:2] + np.array([0.2, -0.1])
    point = rig.rotation.T @ np.array([*across, plane + rig.corrected_at])
    geometry = rig.geometry
    assert geometry.principal_point is not None
    here = np.array([0.2, -0.1]) / rig.corrected_at * geometry.focal_length_px + geometry.principal_point
    for n, camera in enumerate(cameras):
        recorded = camera.project(np.asarray(camera.rotation) @ point + camera.translation)
        rectified = here - geometry.disparity(rig.corrected_at) * rig.positions[n]
        np.testing.assert_allclose(rig.places(n, rectified), recorded, atol=1e-6)


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([(0, 0, 0), (0, 0, 0)], "in one place"),
        ([(0, 0, 0), (0, 0, 1), (0, 0.0, 2)], "along the line"),
        ([(0, 0, 0), (0.01, 0, 1), (0, 0.01, 2)], "along the line"),
        ([(0, 0, 0), (1, 0, 1), (0, 1, -1), (1, 1, 2), (0.5, 0.5, -2)], "plane|degrees away"),
    ],
)
def test_cameras_that_are_no_light_field_are_refused(places: list[tuple[float, ...]], words: str) -> None:
    cameras = [Camera((10, 10), (20, 20), (4.5, 4.5), translation=-np.array(p, float)) for p in places]
    with pytest.raises(LightFieldError, match=words):
        fit_rig(cameras)


def test_calibrations_of_other_pictures_are_refused(boxes: LightField) -> None:
    cameras = ideal_cameras(boxes)
    with pytest.raises(LightFieldError, match="calibrated for pictures of 20 x 10"):
        rectify(boxes, calibration=known(tuple(replace(camera, size=(10, 20)) for camera in cameras)))
    with pytest.raises(LightFieldError, match="calibrates 4 cameras, there are 9 pictures"):
        rectify(boxes, calibration=known(tuple(replace(camera, name=f"c{n}") for n, camera in enumerate(cameras[:4]))))
    with pytest.raises(LightFieldError, match="no camera for view_008"):
        rectify(boxes, calibration=known(cameras[:8]))
    away = (*cameras[:8], replace(cameras[8], rotation=turned((0, 2.0, 0))))
    with pytest.raises(LightFieldError, match=r"view_008\.png looks 1\d+ degrees away"):
        rectify(boxes, calibration=known(away))
    larger = (*cameras[:8], replace(cameras[8], size=(1280, 1440)))  # of pictures ten times as large, with this matrix
    with pytest.raises(LightFieldError, match=r"view_008\.png has a focal length of .* px, the others about .* px"):
        rectify(boxes, calibration=known(larger))
    names = (*(f"view_{n:03d}.png" for n in range(8)), "other/view_007.jpg")
    with pytest.raises(LightFieldError, match=r"view_007\.png and other/view_007\.jpg both have the name of"):
        rectify(replace(boxes, files=names), calibration=known(tuple(cameras)))


def test_cameras_that_see_nothing_of_what_the_others_see(boxes: LightField) -> None:
    """One is left out with a note; if only the reference is left, there is no light field."""
    cameras = ideal_cameras(boxes)

    def away(camera: Camera, angle: float) -> Camera:
        turn = turned((0, angle, 0)) @ np.asarray(camera.rotation)
        return replace(camera, rotation=turn, translation=-turn @ camera.centre)

    one = tuple(away(camera, 0.9) if n == 2 else camera for n, camera in enumerate(cameras))
    found = rectify(boxes, calibration=known(one)).light_field
    assert len(found.views) == 8
    assert any("Left out, as nothing of it is in the common frame: view_002.png" in note for note in found.notes)
    apart = tuple(away(camera, 0.9 * (n % 3 - 1)) for n, camera in enumerate(cameras))
    with pytest.raises(LightFieldError, match=r"show nothing of what view_00\d\.png shows"):
        rectify(boxes, calibration=known(apart))


def test_a_calibration_of_larger_pictures_is_scaled(boxes: LightField) -> None:
    larger = tuple(
        replace(
            camera,
            size=(256, 288),
            focal_length=(2 * camera.focal_length[0], 2 * camera.focal_length[1]),
            principal_point=(2 * camera.principal_point[0] + 0.5, 2 * camera.principal_point[1] + 0.5),
        )
        for camera in ideal_cameras(boxes)
    )
    found = rectify(boxes, calibration=known(larger)).light_field
    assert rms(found.views, boxes.views) < 0.01


def test_refinement_lines_views_up(boxes: LightField) -> None:
    wrong = disturb(boxes, Misalignment(shift=0.7, roll=0.1, scale=1e-3, gain=0.08), seed=5)
    found = refine(wrong.light_field)
    assert found.kept
    assert found.psnr_after > found.psnr_before + 3
    assert lfgpu.explain(found.light_field, boxes.truth.disparity).misalignment < 0.04
    np.testing.assert_allclose(found.tones.gain, wrong.gain, atol=0.02)
    assert (found.light_field.views[4] == boxes.views[4]).all()  # the reference view is what others are told against
    assert found.light_field.grid_shape == (3, 3)


@pytest.mark.thorough
def test_cameras_off_by_pixels_are_found_in_small_pictures() -> None:
    """Twelve cameras in no grid; without smooth pictures at first, some of them end two pixels beside."""
    lf = scenes.make("boxes", grid=(9, 9), size=(128, 128), seed=7, noise=0.004)
    others = np.random.default_rng(0).permutation([n for n in range(81) if n != 40])[:11]
    wrong = disturb(lf.subset(sorted([40, *map(int, others)])), Misalignment(shift=1.5), seed=0)
    found = refine(wrong.light_field, disparity_range=(-2, 2))
    assert found.psnr_after > found.psnr_before + 4.5


@pytest.mark.thorough
def test_the_level_that_views_do_not_tell_is_said(boxes: LightField) -> None:
    """Over draws, maps of lined up views are off by a constant of the size that is said."""
    off, said = [], []
    for seed in range(4):
        wrong = disturb(boxes, Misalignment(shift=0.6), seed=seed)
        found = refine(wrong.light_field, model="shift", disparity_range=(-2.5, 2.5))
        map_ = lfgpu.estimate_depth(found.light_field, config="fast", disparity_range=(-2.5, 2.5))
        off.append(float(np.nanmedian((map_.disparity - boxes.truth.disparity)[15:-15, 15:-15])))
        said.append(found.level_error)
        assert any(f"about {found.level_error:.2g} px per view step" in note for note in found.light_field.notes)
        assert any(" m that is " in note for note in found.light_field.notes)  # the geometry is known
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean(said), rel=0.7)
    assert np.mean(said) == pytest.approx(0.6 / np.sqrt((boxes.offsets**2).sum()), rel=0.3)


def test_what_is_right_is_left_alone(boxes: LightField) -> None:
    found = refine(boxes)
    assert not found.kept
    assert found.light_field is boxes
    assert found.level_error == 0
    assert "nothing" in found.status


def test_positions_are_found() -> None:
    moved = np.random.default_rng(2).normal(0, 0.1, (9, 2))
    moved[4] = 0
    lf = scenes.make("planes", grid=(3, 3), size=(128, 128), seed=2, displaced=moved)
    found = refine(lf, model="shift", positions=True)
    offsets = lf.offsets
    wanted = moved - (moved * offsets).sum() / (offsets**2).sum() * offsets
    assert np.abs(found.position_change - wanted).max() < 0.5 * np.abs(wanted).max()
    assert np.sqrt(((found.position_change - wanted) ** 2).mean()) < 0.02


def test_equalisation_by_itself(boxes: LightField) -> None:
    wrong = disturb(boxes, Misalignment(gain=0.1, offset=0.02, vignetting=0.2), seed=6)
    found = equalise(wrong.light_field)
    assert found.kept
    assert rms(wrong.light_field.views, boxes.views) > 0.03
    assert rms(found.light_field.views, boxes.views) < 0.01
    np.testing.assert_allclose(found.homographies, np.tile(np.eye(3), (9, 1, 1)))


def test_wrong_arguments_are_refused(boxes: LightField, tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match="model must be one of"):
        refine(boxes, model="bent")
    flat = LightField.from_grid(np.full((3, 3, 32, 32), 128, np.uint8))
    with pytest.raises(LightFieldError, match="texture"):
        refine(flat, disparity_range=(-1, 1))
    with pytest.raises(LightFieldError, match="an empty folder"):
        rectify(tmp_path)
    with pytest.raises(LightFieldError, match="unit must be one of mm, cm, m, not 'foot'"):
        rectify(boxes, calibration=known(tuple(ideal_cameras(boxes))), unit="foot", depths=(1, 2))


def recorded(folder: Path, lf: LightField, cameras: list[Camera]) -> Path:
    """Pictures, and beside them the calibration of their cameras."""
    for n, view in enumerate(lf.views):
        Image.fromarray(view).save(folder / f"view_{n:03d}.png")
    write_cameras(cameras, folder / "cameras.toml")
    return folder / "cameras.toml"


def test_pictures_and_a_calibration_become_a_light_field_with_one_command(boxes: LightField, tmp_path: Path) -> None:
    wrong = disturb(boxes, Misalignment(shift=2, roll=0.3), seed=3)
    recorded(tmp_path, wrong.light_field, list(wrong.cameras))
    run = command("rectify", tmp_path, "-o", tmp_path / "out", "--points")
    assert run.code == 0, run.err
    found = lfgpu.read(tmp_path / "out")
    assert len(found.views) == 9
    assert found.valid is not None
    np.testing.assert_allclose(np.abs(found.offsets - boxes.offsets), 0, atol=1e-3)
    assert found.geometry.baseline_m == pytest.approx(boxes.geometry.baseline_m, rel=1e-3)
    assert (tmp_path / "out" / "points.ply").stat().st_size > 1000
    depth = read_map(tmp_path / "out" / "original_depth.pfm")
    true = boxes.geometry.depth(boxes.truth.disparity)  # the reference camera is as it should be
    assert np.nanmedian(np.abs(depth / true - 1)) < 0.01
    assert np.load(tmp_path / "out" / "rectified.npz")["rotations"].shape == (9, 3, 3)
    assert command("rectify", tmp_path, "-o", tmp_path / "out").code == 0
    assert not list((tmp_path / "out").glob("*.ply")) + list((tmp_path / "out").glob("*.pfm"))  # of the first map
    refused(command("rectify", tmp_path, "-o", tmp_path / "o2", "--positions"), "--positions is for --refine")
    refused(command("rectify", tmp_path, "-o", tmp_path / "o2", "--model", "shift"), "--model is for --refine")


def test_what_cannot_be_done_is_refused_before_any_work(
    boxes: LightField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a metric depth there are no points; an output may be a folder; a calibration may be missing."""
    out = tmp_path / "out"
    (out / "points.ply").mkdir(parents=True)
    plain = tmp_path / "plain"
    plain.mkdir()
    for n, view in enumerate(boxes.views):
        Image.fromarray(view).save(plain / f"view_{n // 3}_{n % 3}.png")
        Image.fromarray(view).save(out / f"view_{n:03d}.png")
    files = tuple(str(out / f"view_{n:03d}.png") for n in range(9))
    write_description(replace(boxes, geometry=None, files=files), tmp_path / "lf.toml", source={})
    new = tmp_path / "new"
    with monkeypatch.context() as context:
        context.setattr("lfgpu.calibration.rectify", pytest.fail)
        refused(command("rectify", plain, "--refine", "-o", new, "--points"), "--points needs a calibration")
    monkeypatch.setattr("lfgpu.io.views.read_view", pytest.fail)
    refused(command("rectify", tmp_path / "lf.toml", "--refine", "-o", out), "is part of the input")
    refused(
        command("rectify", plain, "--refine", "-o", out, "--points"), "points.ply cannot be written: it is a folder"
    )
    refused(command("rectify", plain, "-o", new, "--calibration", tmp_path / "none.toml"), "none.toml does not exist")
    refused(command("export", plain, "-o", new, "--rectify", plain), "holds no rectified.npz")


def test_the_input_is_not_written_over(boxes: LightField, tmp_path: Path) -> None:
    recorded(tmp_path, boxes, ideal_cameras(boxes))
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    refused(command("rectify", tmp_path, "-o", tmp_path / ".." / tmp_path.name), "which is the input")
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_notes_are_of_the_rectified_views_and_not_of_the_pictures(boxes: LightField, tmp_path: Path) -> None:
    """Pictures of cameras that are far out of line contradict their places; a calibration knows why."""
    wrong = disturb(boxes, Misalignment(shift=8), seed=3)
    recorded(tmp_path, wrong.light_field, list(wrong.cameras))
    assert "By their parallax" in lfgpu.read(tmp_path, grid=(3, 3)).notes[-1]
    found = rectify(lfgpu.read(tmp_path, grid=(3, 3)), calibration=tmp_path / "cameras.toml")
    assert found.light_field.notes == ()
    swapped = replace(
        boxes, views=np.flip(boxes.views.reshape(3, 3, *boxes.views.shape[1:]), 0).reshape(boxes.views.shape)
    )
    (note,) = rectify(swapped, tones=True).light_field.notes
    assert note.startswith("By their parallax")
    write_rectified(found, out := tmp_path / "out")
    (out / "points.ply").write_text("of another map")
    write_rectified(found, out)
    assert not (out / "points.ply").exists()


def test_a_wrong_calibration_is_one_sentence(boxes: LightField, tmp_path: Path) -> None:
    file = recorded(tmp_path, boxes, ideal_cameras(boxes))
    file.write_text(file.read_text().replace("view_008.png", "view_007.png"))
    run = command("rectify", tmp_path, "-o", tmp_path / "out")
    refused(run, "has 2 cameras of the name view_007.png; give each")
    assert not (tmp_path / "out").exists()


def test_cameras_of_other_names_are_taken_in_order_and_that_is_said(boxes: LightField, tmp_path: Path) -> None:
    file = recorded(tmp_path, boxes, ideal_cameras(boxes))
    assert not any("in order" in note for note in rectify(tmp_path).light_field.notes)
    file.write_text(file.read_text().replace("view_", "device_"))
    notes = " ".join(rectify(tmp_path).light_field.notes)
    assert "matched in order: view_000.png is of device_000.png, ..., view_008.png of device_008.png." in notes


def test_the_truth_is_that_of_the_rectified_cameras_and_all_is_read_back(boxes: LightField, tmp_path: Path) -> None:
    """They have another disparity 0 than the pictures; without the depth nobody knows theirs."""
    wrong = disturb(boxes, Misalignment(shift=1), seed=3)
    rectified = rectify(wrong.light_field, calibration=known(wrong.cameras))
    found = rectified.light_field
    assert np.abs(np.median(found.truth.disparity - boxes.truth.disparity)) > 0.03
    map_ = lfgpu.estimate_depth(found, config="fast", check_cameras=False)
    assert np.median(np.abs(map_.disparity - found.truth.disparity)[15:-15, 15:-15]) < 0.03
    flat = replace(wrong.light_field, geometry=None)
    assert rectify(flat, calibration=known(wrong.cameras)).light_field.truth is None
    write_rectified(rectified, tmp_path / "out")
    back = lfgpu.read(tmp_path / "out")
    np.testing.assert_array_equal(back.views, found.views)
    np.testing.assert_array_equal(back.valid, found.valid)
    np.testing.assert_allclose(back.offsets, found.offsets)
    assert back.truth is not None


def test_without_calibration_the_options_are_named() -> None:
    lf = lfgpu.LightField.from_grid(np.zeros((1, 2, 8, 8), np.uint8))
    with pytest.raises(LightFieldError, match=r"--calibration, .*--refine, "):
        rectify(lf)

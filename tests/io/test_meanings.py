"""Light fields told in other words, drawn at random, and each rule that they led to."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from samples import grid_of, planes, refusal, save, save_as, stored_as

from lfgpu.data import LightField
from lfgpu.io import read
from lfgpu.io.contradictions import contradictions
from lfgpu.scenes import make
from tests.io import meanings
from tests.made import thorough


@pytest.mark.parametrize("seed", [*range(10), *(thorough(n) for n in range(10, 30))])
def test_the_same_in_other_words(seed: int, tmp_path: Path) -> None:
    result, way, why = meanings.one(seed, tmp_path)
    assert result != "wrong", f"{way}: {why}"


def test_lies_are_noticed_by_the_comparison() -> None:
    """A light field that was read as another one, without a note, is wrong: the comparison itself can fail."""
    scene = meanings.Scene(meanings._made(1, False)[:3, :4])
    v, u = np.mgrid[:3, :4]
    views = scene.views.reshape(-1, *scene.views.shape[2:])
    told = {"same": (u, v), "reversed": (-u, -v), "cameras at": (u, -v), "cameras": (u, 2 * v)}
    for found, positions in told.items():
        lf = LightField(views, np.stack(positions, axis=-1).reshape(-1, 2).astype(float))
        assert meanings._judged(lf, scene, masked=False).startswith(found)
    lf = LightField(np.roll(views, 1, axis=2), np.stack((u, v), axis=-1).reshape(-1, 2).astype(float))
    assert "none of the pictures" in meanings._judged(lf, scene, masked=False)


@pytest.fixture(scope="module")
def true() -> LightField:
    return planes()


def named(lf: LightField, folder: Path, name: str) -> Path:
    columns = max(lf.positions[:, 0].astype(int)) + 1
    return save_as(folder, lf, lambda v, u: name.format(u=u, v=v, i=columns * v + u))


def test_a_grid_counted_by_the_second_of_two_numbers_is_asked_about(true: LightField, tmp_path: Path) -> None:
    folder = named(true, tmp_path / "grid", "run 02_{i:02d}.png")
    assert "by the pictures --grid 3x4 fits" in refusal(lambda: read(folder))
    np.testing.assert_array_equal(read(folder, grid=(3, 4)).view(2, 1), true.view(2, 1))
    row = named(true.subset("row"), tmp_path / "row", "view_00_{u:02d}.png")
    assert read(row).grid_shape == (1, 4)
    column = named(true.subset("column"), tmp_path / "column", "view_{v:02d}_00.png")
    assert read(column).grid_shape == (3, 1)


@pytest.mark.parametrize("name", ["row{v}_col{u}.png", "row{v}_col1{u}.png", "y2{v}/x5{u}.png"])
def test_rows_that_run_to_and_fro_are_noticed(true: LightField, tmp_path: Path, name: str) -> None:
    """Also where numbers begin elsewhere, so that rows and columns before them have no views."""
    save_as(tmp_path / "in", true, lambda v, u: name.format(u=u, v=v))
    assert "parallax" not in " ".join(read(tmp_path / "in").notes)
    save_as(tmp_path / "fro", true, lambda v, u: name.format(u=3 - u if v % 2 else u, v=v))
    assert "By their parallax the views do not stand where they are said to stand" in read(tmp_path / "fro").notes[-1]


def test_cameras_of_rows_and_numbers_with_other_words(true: LightField, tmp_path: Path) -> None:
    found = read(named(true, tmp_path / "cameras", "cam{u}/row{v}.png"))
    np.testing.assert_array_equal(found.view(2, 1), true.view(2, 1))
    assert "column (cameras of each row)" in found.reading.places
    for name in ("row{v}_cam{i}.png", "dial{u}_row{v}.png"):
        folder = named(true, tmp_path / name, name)
        assert "it cannot be known what the numbers" in refusal(lambda folder=folder: read(folder))


def test_arrays_without_any_order_that_makes_sense_are_asked_about(true: LightField, tmp_path: Path) -> None:
    grid = grid_of(true)
    np.save(tmp_path / "a.npy", stored_as("vxyuc", grid))
    assert "--axes ORDER, one letter of v, u (or n), y, x and c for each axis" in refusal(
        lambda: read(tmp_path / "a.npy")
    )
    np.testing.assert_array_equal(read(tmp_path / "a.npy", axes="vxyuc").views, true.views)
    for count in (2, 3, 4):  # grey views that may pass for colours
        np.save(tmp_path / "b.npy", grid[:, :count, :, :, 1].transpose(0, 2, 3, 1))
        assert "look like views; say the order with --axes, such as vyxu" in refusal(lambda: read(tmp_path / "b.npy"))
    np.save(tmp_path / "c.npy", grid[:1].transpose(4, 0, 1, 2, 3)[:, 0])  # c, n, y, x
    assert "--axes" in refusal(lambda: read(tmp_path / "c.npy"))


def test_mosaics_of_blocks_of_two_and_mosaics_given_as_tiles(tmp_path: Path) -> None:
    save(tmp_path / "a.png", stored_as("yvxuc", grid_of(planes((2, 2)))).reshape(192, 224, 3))
    assert read(tmp_path / "a.png", format="mosaic").grid_shape == (2, 2)
    told = refusal(lambda: read(tmp_path / "a.png", format="tiles", grid=(2, 2)))
    assert "--format mosaic" in told
    assert (
        "blocks of 2 x 2 repeat in the picture, not the 4 x 4"
        in read(tmp_path / "a.png", format="mosaic", grid=(4, 4)).notes[0]
    )


def test_pictures_that_contradict_their_places(true: LightField, tmp_path: Path) -> None:
    notes = read(named(true, tmp_path / "true", "row{v}_col{u}.png")).notes
    assert notes == ()
    copied = named(true, tmp_path / "copied", "row{v}_col{u}.png")
    Image.fromarray(true.view(0, 1)).save(copied / "row0_col3.png")
    assert "row 0, column 1 and at row 0, column 3 are the same picture" in read(copied).notes[-1]
    other = named(true, tmp_path / "other", "row{v}_col{u}.png")
    save(other / "row1_col1.png", make("boxes", grid=(1, 2), size=(96, 112), seed=4).views[0])
    assert "The picture at row 1, column 1 does not look like" in read(other).notes[-1]
    for time in range(5):
        noise = np.random.default_rng(time).normal(0, (0.5, 6)[time % 2], true.views[0].shape)
        save(tmp_path / "one" / f"cam{time}.png", np.clip(true.views[0] + noise, 0, 255).astype(np.uint8))
    assert "The views show no parallax, even those that are farthest apart" in read(tmp_path / "one").notes[-1]
    np.save(tmp_path / "planes.npy", stored_as("cnyx", true.views[:9]).reshape(27, 96, 112))  # taken for views
    far = read(tmp_path / "planes.npy", grid=(1, 27)).notes[-1]
    assert "By their parallax" in far or "from the place of the reference" in far
    still = tmp_path / "still"
    for time in range(3):  # of which one camera after the other is told, without words
        for camera, view in enumerate(true.subset("row").views):
            save(still / f"{time}_{camera}.png", np.clip(view.astype(int) + 3 * time, 0, 255).astype(np.uint8))
    assert "the camera stood still between the views of a column" in read(still).notes[-1]


@pytest.mark.parametrize("degrees", [5, 20, 70, 85])
def test_edges_of_one_direction_do_not_tell_where_cameras_stand(degrees: int) -> None:
    """Motion seems to be across stripes, whatever it is: of cameras that move along them nothing is seen."""
    rng, (y, x) = np.random.default_rng(degrees), np.mgrid[:160, :160]
    stripes, angle = np.cumsum(rng.normal(0, 0.02, 4000)), np.deg2rad(degrees)
    offsets = np.array([[u, v] for v in range(-2, 3) for u in range(-2, 3)], np.float64)
    along = [np.cos(angle) * (x + 0.7 * u) + np.sin(angle) * (y + 0.7 * v) for u, v in offsets]
    views = np.stack([np.interp(4 * place + 1500, np.arange(4000), stripes) for place in along])
    views += 0.5 - views.mean() + rng.normal(0, 0.005, views.shape)
    assert contradictions(LightField(views[..., None].clip(0, 1).astype(np.float32), offsets, reference=12)) == ()


def test_transparency_that_is_no_mask_and_pages_on_their_side(true: LightField, tmp_path: Path) -> None:
    folder = tmp_path / "clear"
    for n in range(2):
        save(folder / f"cam{n}.png", np.concatenate([true.views[n], np.zeros_like(true.views[n][..., :1])], axis=-1))
    assert "All pixels are transparent, so transparency is not taken for a mask." in read(folder).notes
    value = true.views[0][5, 5]
    for n in range(2):  # one colour that is transparent
        Image.fromarray(true.views[n]).save(folder / f"cam{n}.png", transparency=tuple(map(int, value)))
    found = read(folder)
    assert found.valid is not None
    np.testing.assert_array_equal(found.valid, (true.views[:2] != value).any(axis=-1))
    tifffile = pytest.importorskip("tifffile")
    for view in true.views[:4]:
        tifffile.imwrite(tmp_path / "a.tif", view, append=True, photometric="rgb", extratags=[(274, 3, 1, 6, True)])
    assert "pages that are stored turned" in refusal(lambda: read(tmp_path / "a.tif"))


def test_views_last_are_no_alpha_channel(true: LightField, tmp_path: Path) -> None:
    grid = grid_of(true)
    for count in (2, 4):
        np.save(tmp_path / "a.npy", grid[:, :count, ..., 1].transpose(0, 2, 3, 1)[:, None])  # [v, c, y, x, u]
        assert "look like views" in refusal(lambda: read(tmp_path / "a.npy", grid=(3, 1)))
    mask = np.zeros((*true.views.shape[:3], 1), np.uint8)
    mask[:, 20:60, 30:70] = 255
    mask[:, 19], mask[:, 60] = 128, 128  # soft edges
    np.save(tmp_path / "a.npy", np.concatenate([true.views, mask], axis=-1))
    found = read(tmp_path / "a.npy", grid=(3, 4)).valid
    assert found is not None
    np.testing.assert_array_equal(found, mask[..., 0] > 127)


def test_cameras_and_times_without_words(true: LightField, tmp_path: Path) -> None:
    row = true.subset("row")
    for time in range(2):
        for camera, view in enumerate(row.views):
            save(tmp_path / f"rgb_{camera + 3:02d} {time:02d}.png", meanings._later(view, time))
    text = refusal(lambda: read(tmp_path))
    assert '"rgb_{v} {u}.png" if there are no others' in text
    np.testing.assert_array_equal(read(tmp_path, pattern="rgb_{n} {t}.png", grid=(1, 4)).views, row.views)
    assert "the camera stood still between the views of a row" in read(tmp_path, allow_missing=True).notes[-1]
    assert read(tmp_path, pattern="rgb_{v} {u}.png").grid_shape == (4, 2)


def test_left_and_right_and_distances(true: LightField, tmp_path: Path) -> None:
    row = true.subset("row")
    for number, names in enumerate(
        (("left", "right"), ("view1_R5_L", "view1_R5_R"), ("left", "center", "right"), ("a/imgLeft8", "a/imgRight8"))
    ):
        folder = tmp_path / str(number)
        for name, view in zip(names, row.views, strict=False):
            save(folder / f"{name}.png", view)
        np.testing.assert_array_equal(read(folder).views, row.views[: len(names)])
    for name in ("left_0.png", "left_1.png", "right_0.png", "right_1.png"):
        save(tmp_path / "video" / name, row.views[int("right" in name)])
    assert 'say --pattern "{u}_{t}.png"' in refusal(lambda: read(tmp_path / "video"))
    np.testing.assert_array_equal(read(tmp_path / "video", pattern="{u}_{t}.png", frame=1).views, row.views[:2])
    for index, (v, u) in enumerate(np.ndindex(3, 4)):
        save(tmp_path / "distances" / f"y{25 * v}_x{25 * u + 1}.png", true.views[index])
        save(tmp_path / "beside" / f"take2 x{25 * u} y{25 * v}.png", true.views[index])
    for name in ("distances", "beside"):
        np.testing.assert_array_equal(read(tmp_path / name).view(1, 2), true.view(1, 2))
        assert read(tmp_path / name).grid_shape == (3, 4)


def test_an_alpha_channel_among_views(true: LightField, tmp_path: Path) -> None:
    mask = np.random.default_rng(0).random((*true.views.shape[:3], 1)) < 0.8
    views = np.concatenate([true.views, 255 * mask.astype(np.uint8)], axis=-1)[:4]
    np.save(tmp_path / "a.npy", stored_as("cnyx", views))  # taken for a grid
    assert "does not look like the reference" in read(tmp_path / "a.npy").notes[-1]


def test_planes_of_colours_as_pages(true: LightField, tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    for axes in ("ncyx", "cnyx"):
        pages = stored_as(axes, true.views).reshape(-1, *true.size)
        tifffile.imwrite(tmp_path / "a.tif", pages, photometric="minisblack", metadata=None)
        assert "if they are colours, say --axes ncyx" in refusal(lambda: read(tmp_path / "a.tif", grid=(3, 4)))
        np.testing.assert_array_equal(read(tmp_path / "a.tif", grid=(3, 4), axes=axes).views, true.views)


def test_words_that_may_name_cameras_and_calibrations_beside_pictures(true: LightField, tmp_path: Path) -> None:
    for name in ("left/{u:04d}.png", "right/{u:04d}.png", "a/left_{u:04d}.png", "a/right_{u:04d}.png"):
        named(true.subset("row"), tmp_path, name)
    assert "If these names are cameras and the numbers times" in refusal(lambda: read(tmp_path / "a"))
    (tmp_path / "b").mkdir()
    for side in ("left", "right"):
        (tmp_path / side).rename(tmp_path / "b" / side)
    assert "If these folders are cameras and the numbers times" in refusal(lambda: read(tmp_path / "b"))
    (tmp_path / "b" / "left" / "transforms.json").write_text('{"camera_angle_x": 1, "frames": []}')
    assert "transforms.json may say where the cameras stand" in read(tmp_path / "b" / "left").notes[0]
    assert "looks like a calibration" in refusal(lambda: read(tmp_path / "b" / "left" / "transforms.json"))

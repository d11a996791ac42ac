"""HCI 4D folders, read and written."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import CFG, HEIGHT, WIDTH, picture, refusal, save, save_hci

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.io import read, read_map, write_hci, write_pfm


def test_hci_grid_and_geometry(tmp_path: Path) -> None:
    light_field = read(save_hci(tmp_path, range(6), rows=2, columns=3))
    assert (light_field.grid_shape, light_field.notes) == ((2, 3), ())
    np.testing.assert_array_equal(light_field.view(1, 2), picture(5))  # index = columns * row + column
    assert light_field.positions[light_field.reference_index].tolist() == [1, 1]
    # 100 mm / 35 mm * 5 px, the longer side of the views
    assert light_field.geometry == Geometry(100 / 35 * 5, 0.025, 4.25, unshifted_at=(1.0, 1.0))


def test_hci_truth_and_mask_belong_to_the_centre_view(tmp_path: Path) -> None:
    save_hci(tmp_path, range(10), rows=2, columns=5)
    disparity = np.arange(HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    disparity[0, 1] = np.inf
    write_pfm(tmp_path / "gt_disp_lowres.pfm", disparity)
    save(tmp_path / "valid_mask.png", (disparity > 7)[..., None].astype(np.uint8))
    light_field = read(tmp_path)
    truth = light_field.reference_truth()
    assert truth.position == (2.0, 1.0)
    disparity[0, 1] = np.nan
    np.testing.assert_array_equal(truth.disparity, disparity)
    np.testing.assert_array_equal(truth.mask[1:], disparity[1:] > 7)


def test_hci_with_lost_views(tmp_path: Path) -> None:
    save_hci(tmp_path, set(range(9)) - {5})
    assert "row 1 column 2" in refusal(lambda: read(tmp_path))
    assert read(tmp_path, allow_missing=True).missing == ((1, 2),)


@pytest.mark.parametrize("indices", [range(9), [0, 2, 4, 8]])
def test_hci_without_parameters_takes_a_square(tmp_path: Path, indices: Iterable[int]) -> None:
    light_field = read(save_hci(tmp_path, indices, cfg=None))
    assert light_field.grid_shape == (3, 3)
    assert light_field.geometry is None
    assert light_field.notes[0].startswith("There is no parameters.cfg: a square grid is assumed")
    text = refusal(lambda: read(save_hci(tmp_path / "six", range(6), cfg=None)))
    assert f"{tmp_path / 'six'}" in text
    assert "no parameters.cfg" in text
    assert "num_cams_x" in text


def test_hci_with_a_grid_but_without_lengths_or_of_another_size(tmp_path: Path) -> None:
    grid = "[extrinsics]\nnum_cams_x=2\nnum_cams_y=1"
    light_field = read(save_hci(tmp_path / "a", range(2), rows=1, columns=2, cfg=grid))
    assert light_field.geometry is None
    assert light_field.notes == ("parameters.cfg does not describe the cameras: metric depth is not known.",)
    larger = read(save_hci(tmp_path / "b", range(9), cfg=CFG.replace("resolution_x_px = 5", "resolution_x_px = 10")))
    assert "is for views of 10 x 4 pixels and these have 5 x 4" in larger.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("num_cams_x = {columns}", "num_cams_x = 2", ["3 x 2 views", "index 5", "index 8"]),
        ("num_cams_x = {columns}", "", ["no num_cams_x in [extrinsics]"]),
        ("num_cams_y = {rows}", "num_cams_y = three", ["num_cams_y must be a number", "'three'"]),
        ("num_cams_y = {rows}", "num_cams_y = 2.5", ["num_cams_y must be a whole number", "2.5"]),
        ("num_cams_y = {rows}", "num_cams_y = 1e12", ["num_cams_y", "1000"]),
        ("num_cams_y = {rows}", "num_cams_y = 0", ["num_cams_y", "0"]),
        ("baseline_mm = 25.0", "", ["no baseline_mm in [extrinsics]"]),
        ("baseline_mm = 25.0", "baseline_mm = -25", ["baseline_m must be a positive number"]),
        ("baseline_mm = 25.0", "baseline_mm = 2,5", ["baseline_mm must be a number", "'2,5'"]),
        ("focal_length_mm = 100.0", "focal_length_mm =", ["focal_length_mm must be a number", "''"]),
        ("focal_length_mm = 100.0", "focal_length_mm = nan", ["focal_length_px", "nan"]),
        ("sensor_size_mm = 35.0", "sensor_size_mm = 0", ["sensor_size_mm must be positive"]),
        ("resolution_x_px = 5", "resolution_x_px = inf", ["image_resolution_x_px must be a whole number", "inf"]),
        ("[extrinsics]", "", ["no num_cams_y in [extrinsics]"]),
        ("[intrinsics]", "intrinsics", ["not a valid configuration file"]),
        ("scene = 100 % cotton", "scene = 1\nscene = 2", ["not a valid configuration file", "scene"]),
    ],
)
def test_hci_parameters_that_contradict_or_lack_something(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in CFG
    text = refusal(lambda: read(save_hci(tmp_path, range(9), cfg=CFG.replace(old, new))))
    assert str(tmp_path / "parameters.cfg") in text
    assert all(word in text for word in words), text
    (tmp_path / "parameters.cfg").write_bytes(b"\xff\xfe\x00")
    assert "parameters.cfg is not a valid configuration file" in refusal(lambda: read(tmp_path))


@pytest.mark.parametrize("name", ["gt_disp_lowres.pfm", "valid_mask.png"])
def test_hci_truth_of_another_size(tmp_path: Path, name: str) -> None:
    save_hci(tmp_path, range(9))
    write_pfm(tmp_path / "gt_disp_lowres.pfm", np.zeros((HEIGHT, WIDTH + (name == "gt_disp_lowres.pfm"))))
    save(tmp_path / "valid_mask.png", picture(0, 1)[:3])
    text = refusal(lambda: read(tmp_path))
    assert name in text
    assert "the views have 5 x 4" in text


# --- writing ---


def scene(dtype: Any = np.uint8, channels: int = 3, **fields: Any) -> LightField:
    views = np.stack([picture(index, channels, dtype) for index in range(6)])
    return LightField.from_grid(views.reshape(2, 3, HEIGHT, WIDTH, channels), **fields)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_hci_round_trip(tmp_path: Path, dtype: Any, channels: int) -> None:
    disparity = np.random.default_rng(9).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    disparity[0, 0] = np.nan
    light_field = scene(
        dtype,
        channels,
        geometry=Geometry(1234.5, 0.0173, 2.1, principal_point=(1.25, 2.0)),
        truth=GroundTruth(disparity, (1.0, 1.0), disparity > 0),
        name="100 % new\nscene",
    )
    assert write_hci(light_field, tmp_path / "a" / "b") == ()
    found = read(tmp_path / "a" / "b")
    assert found.views.dtype == dtype
    np.testing.assert_array_equal(found.views, light_field.views)
    assert (found.grid_shape, found.reference, found.notes) == ((2, 3), light_field.reference, ())
    assert found.geometry.principal_point == (1.25, 2.0)
    lengths = found.geometry.focal_length_px, found.geometry.baseline_m, found.geometry.focus_distance_m
    assert lengths == pytest.approx((1234.5, 0.0173, 2.1), rel=1e-12)
    assert found.truth.mask is not None
    np.testing.assert_array_equal(found.truth.disparity, disparity)
    np.testing.assert_array_equal(found.truth.mask, disparity > 0)
    depth = read_map(tmp_path / "a" / "b" / "gt_depth_lowres.pfm")
    np.testing.assert_allclose(depth, found.geometry.depth(disparity), rtol=1e-6)
    assert np.isnan(depth[0, 0])


def test_hci_round_trip_of_some_views_without_geometry_or_with_parallel_frames(tmp_path: Path) -> None:
    some = scene().subset("cross")
    write_hci(some, tmp_path / "a")
    found = read(tmp_path / "a")
    np.testing.assert_array_equal(found.positions, some.positions)
    assert (found.missing, found.geometry) == (some.missing, None)
    for geometry in (Geometry(100.0, 0.5), Geometry(100.0, 0.5, 2.0, pixel_aspect=0.75, unshifted_at=(2.0, 0.5))):
        write_hci(scene(geometry=geometry), tmp_path / "b")
        assert read(tmp_path / "b").geometry == geometry


def test_hci_says_what_it_left_out(tmp_path: Path) -> None:
    light_field = scene(np.float32, truth=GroundTruth(np.zeros((HEIGHT, WIDTH), np.float32), (0.0, 0.0)))
    light_field = replace(light_field, valid=np.ones((6, HEIGHT, WIDTH), np.bool_), reference=0)
    left_out = write_hci(light_field, tmp_path / "a")
    assert [sentence.split(" w")[0] for sentence in left_out] == [
        "The float32 views",
        "The ground truth",
        "The validity of the views' pixels",
        "The choice of the reference view",
    ]
    found = read(tmp_path / "a")
    assert (found.truth, found.views.dtype) == (None, np.uint16)
    np.testing.assert_allclose(found.image(3), light_field.views[3], atol=0.5001 / 65535)
    array = replace(scene(name="array"), grid_shape=None)
    assert "array is not a grid of views" in refusal(lambda: write_hci(array, tmp_path / "b"))
    assert not (tmp_path / "b").exists()


def test_hci_does_not_mix_with_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "license.txt").write_text("mine")
    truth = GroundTruth(np.zeros((HEIGHT, WIDTH), np.float32), (1.0, 1.0))
    write_hci(scene(truth=truth), tmp_path)
    write_hci(scene(truth=truth, name="again"), tmp_path)
    before = sorted(tmp_path.iterdir())
    assert "holds gt_disp_lowres.pfm of another" in refusal(lambda: write_hci(scene(), tmp_path))
    assert "holds input_Cam000.png of another" in refusal(
        lambda: write_hci(scene(truth=truth).subset("cross"), tmp_path)
    )
    assert sorted(tmp_path.iterdir()) == before
    assert "again" in (tmp_path / "parameters.cfg").read_text()

"""What the viewer shows, without a browser: refocused pictures, points in space, contents, frames of pixels."""

from __future__ import annotations

import gc
import json
import re
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data.geometry import Geometry
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_hci, write_pfm
from lfgpu.viewer import Viewer, pictures, saving
from lfgpu.viewer.board import Board
from lfgpu.viewer.cloud import Cloud, nearest_to_ray, shown_cloud, surface
from lfgpu.viewer.contents import LIVE, TRUTH, Contents, Entry, opened, opened_all
from lfgpu.viewer.facts import Facts, fixed
from lfgpu.viewer.pictures import histogram
from lfgpu.viewer.place import Place
from lfgpu.viewer.space import framed
from lfgpu.viz import panels as frames
from lfgpu.viz.refocusing import all_in_focus, refocus

SIZE = (24, 32)
WHOLE = (0, 0, pictures.TILE)  # column, row and side of the tile that is the whole of a small picture


def wall(disparity: float, *, valid: bool = False) -> LightField:
    """A plane of one disparity, drawn by hand: each view is the same texture, shifted."""
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float64)
    views = np.empty((3, 3, *SIZE, 1), np.float32)
    for v in range(3):
        for u in range(3):
            px, py = x + disparity * (u - 1), y + disparity * (v - 1)
            views[v, u, ..., 0] = 0.5 + 0.2 * np.sin(0.7 * px) + 0.2 * np.cos(0.9 * py)
    mask = np.ones((9, *SIZE), np.bool_)
    if valid:
        views[0, 0], mask[0] = 0, False
    return LightField.from_grid(views, valid=mask if valid else None)


@pytest.mark.parametrize("disparity", [1.0, -2.0, 0.0])
@pytest.mark.parametrize("valid", [False, True])
def test_what_is_in_focus_looks_as_in_the_reference(disparity: float, valid: bool) -> None:
    lf = wall(disparity, valid=valid)
    sharp, blurred = refocus(lf, disparity), refocus(lf, disparity + 2)
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(sharp, reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, disparity, order=1), reference, atol=1e-5)
    assert np.abs(blurred - reference).mean() > 0.05


def test_focus_between_pixels_is_nearly_as_good() -> None:
    lf = wall(0.5)
    error = refocus(lf, 0.5) - lf.image(lf.reference_index)
    assert np.abs(error[2:-2, 2:-2]).max() < 0.05


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("disparity", [-1.5, 0.0, 2.25])
def test_a_preview_is_every_few_pixels_of_the_whole(step: int, disparity: float) -> None:
    lf = wall(1.0)
    truth = DisparityMap(np.full(SIZE, 1.0, np.float32))
    for order in (1, 3):
        whole, sharp = refocus(lf, disparity, order=order), all_in_focus(lf, truth, order=order)
        np.testing.assert_allclose(refocus(lf, disparity, step=step, order=order), whole[::step, ::step], atol=1e-6)
        np.testing.assert_allclose(all_in_focus(lf, truth, step=step, order=order), sharp[::step, ::step], atol=1e-6)


def test_a_preview_of_few_views_has_the_reference_among_them() -> None:
    lf = wall(1.0)
    views = np.zeros_like(lf.views)
    views[lf.reference_index] = 0.9
    dark = LightField(views, lf.positions, reference=lf.reference_index)
    for most in (2, 3):
        assert refocus(dark, 0.0, most_views=most).min() >= 0.9 / most - 1e-6
    for options in ({"step": 0}, {"most_views": 1}, {"order": 2}):
        with pytest.raises(LightFieldError, match=next(iter(options))):
            refocus(lf, 0.0, **options)
        with pytest.raises(LightFieldError, match=next(iter(options))):
            all_in_focus(lf, DisparityMap(np.zeros(SIZE, np.float32)), **options)


def test_everywhere_in_focus_takes_noise_away_and_lets_no_occluder_through() -> None:
    clean = scenes.make("planes", grid=(5, 5), size=(48, 64))
    noisy = scenes.make("planes", grid=(5, 5), size=(48, 64), noise=0.02)
    assert clean.truth is not None
    truth, found = clean.image(clean.reference_index), all_in_focus(noisy, DisparityMap(clean.truth.disparity), order=1)
    before = np.sqrt(np.mean((noisy.image(noisy.reference_index) - truth) ** 2))
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.7 * before


def test_points_stand_where_the_geometry_says() -> None:
    geometry = Geometry(focal_length_px=50.0, baseline_m=0.1, focus_distance_m=2.0)
    disparity = np.zeros(SIZE, np.float32)
    disparity[4, 7] = 5 * 0.5 - 5 / 2.0 + 5.0 / 1.0 - 5.0 / 2.0  # depth 1 m
    disparity[0, 0] = np.nan
    colours = np.zeros((*SIZE, 3), np.uint8)
    colours[4, 7] = 255
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), colours)
    assert cloud.metric
    assert len(cloud.points) == SIZE[0] * SIZE[1] - 1
    (index,) = np.flatnonzero(cloud.colours[:, 0])
    np.testing.assert_allclose(cloud.points[index], [(7 - 15.5) / 50, (4 - 11.5) / 50, 1.0], rtol=1e-5)
    assert nearest_to_ray(cloud, (0, 0, 0), cloud.points[index]) == (7, 4)
    assert nearest_to_ray(cloud, (0, 0, 0), (0, 0, -1)) is None


def test_points_without_a_geometry_keep_the_order_of_disparities() -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    colours = np.zeros((*SIZE, 3), np.uint8)
    sure, unsure = (DisparityMap(disparity, np.full(SIZE, value, np.float32)) for value in (1, 0))
    cloud = shown_cloud(sure, colours, least_confidence=0.5)
    assert not cloud.metric
    assert (np.diff(cloud.points[:, 2]) <= 0).all()  # larger is nearer
    assert np.abs(cloud.points[:, 0]).max() == pytest.approx((SIZE[1] - 1) / 2 / SIZE[1])
    few = shown_cloud(sure, colours, most_points=100)
    assert 0 < len(few.points) <= 100
    assert set(map(tuple, few.pixels)) < set(map(tuple, cloud.pixels))
    assert shown_cloud(unsure, colours, least_confidence=0.5).points.shape == (0, 3)


@pytest.mark.parametrize("most_points", [10_000, 100])
def test_the_points_are_those_of_the_package(most_points: int) -> None:
    """Pixels that are not square, and frames that are shifted against another camera: metres count both."""
    geometry = Geometry(50.0, 0.1, 2.0, pixel_aspect=1.25, unshifted_at=(1.0, 0.0))
    disparity = np.random.default_rng(1).uniform(-1, 1, SIZE).astype(np.float32)
    values = DisparityMap(disparity, position=(4.0, 4.0), geometry=geometry)
    cloud = shown_cloud(values, np.zeros((*SIZE, 3), np.uint8), most_points=most_points)
    points = geometry.points(disparity, position=(4.0, 4.0))
    x, y = cloud.pixels.T
    np.testing.assert_allclose(cloud.points, points[y, x], rtol=1e-6)
    np.testing.assert_allclose(cloud.eye, [0.3, 0.4 / 1.25, 0.0])
    assert cloud.spacing > 0


# --- pictures ---


@pytest.mark.parametrize("kind", list(frames.LOOKS))
def test_undefined_pixels_are_grey_in_every_map(kind: str) -> None:
    values = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    values[3, 4] = np.nan
    colours = frames.colour(values, frames.LOOKS[kind].colours, (-1, 1))
    assert len(set(colours[3, 4].tolist())) == 1
    assert (colours[3, 4] == colours.reshape(-1, 3)).all(axis=1).sum() == 1


# --- contents ---


def test_compared_maps_have_one_scale() -> None:
    contents = Contents(
        None, {name: Entry(DisparityMap(np.full(SIZE, value, np.float32))) for name, value in (("a", -3), ("b", 2))}
    )
    low, high = contents.limits("disparity")
    assert low <= -3
    assert high >= 2
    assert contents.free_name("a") == "a 2"
    assert contents.free_name("c") == "c"


def test_paths_are_taken_in_any_order(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    assert lf.truth is not None
    write_hci(lf, tmp_path / "lf")
    write_pfm(tmp_path / "map.pfm", lf.truth.disparity + 0.1)
    contents = opened_all([tmp_path / "map.pfm", tmp_path / "lf"])
    assert list(contents.all_entries()) == ["map", TRUTH]
    error = contents.map("map", "error")
    assert error is not None
    np.testing.assert_allclose(error, 0.1, atol=1e-5)
    alone = opened_all([tmp_path / "map.pfm"])
    assert alone.size == SIZE
    assert alone.map("map", "error") is None


@pytest.mark.parametrize("suffix", [".npz", ".png", ".tif", ".exr", ".ply"])
def test_what_a_file_says_of_its_map_is_shown(suffix: str, tmp_path: Path) -> None:
    geometry = Geometry(50.0, 0.1, 2.0)
    values = DisparityMap(
        np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE),
        np.full(SIZE, 0.5, np.float32),
        position=(1.0, 2.0),
        geometry=geometry,
    )
    values.save(tmp_path / f"map{suffix}")
    contents = opened(tmp_path / f"map{suffix}", Contents())
    assert contents.geometry == geometry
    assert contents.position == (1.0, 2.0)
    depth, confidence = contents.map("map", "depth"), contents.map("map", "confidence")
    assert depth is not None
    np.testing.assert_allclose(depth, geometry.depth(values.disparity), rtol=1e-3)
    assert (confidence is not None) == (suffix in (".npz", ".exr", ".ply"))
    assert confidence is None or (confidence == 0.5).all()


def test_a_light_field_in_a_file_named_as_maps_are_is_one(tmp_path: Path) -> None:
    lf = wall(1.0)
    np.save(tmp_path / "views.npy", lf.views.reshape(3, 3, *SIZE, 1))
    contents = opened(tmp_path / "views.npy", Contents())
    assert contents.lf is not None
    np.testing.assert_array_equal(contents.lf.views, lf.views)


def test_a_map_brings_the_reference_view_along(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    write_hci(lf, tmp_path / "lf")
    DisparityMap(np.zeros(SIZE, np.float32), position=(2.0, 0.0)).save(tmp_path / "map.npz")
    contents = opened_all([tmp_path / "lf", tmp_path / "map.npz"])
    assert contents.position == (2.0, 0.0)


def test_what_does_not_belong_is_refused(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    write_hci(lf, tmp_path / "lf")
    write_pfm(tmp_path / "small.pfm", np.zeros((5, 6)))
    with pytest.raises(LightFieldError, match="6 x 5 pixels, what is shown has 32 x 24"):
        opened_all([tmp_path / "lf", tmp_path / "small.pfm"])
    with pytest.raises(LightFieldError, match="second light field"):
        opened_all([tmp_path / "lf", tmp_path / "lf"])
    with pytest.raises(LightFieldError, match=r"nowhere\.pfm does not exist"):
        opened(tmp_path / "nowhere.pfm", Contents())
    with pytest.raises(LightFieldError, match="does not exist"):
        opened(tmp_path / "nowhere", Contents())


def test_scores_belong_to_their_frame() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(40, 48))
    assert lf.truth is not None
    board = Board()
    board.show(lf, DisparityMap(lf.truth.disparity + 0.1), name="mine")
    scores = board.contents.scores("mine")
    assert scores is not None
    assert scores.badpix_07 == 100
    board.update(lf.truth.disparity)  # of an unknown frame
    assert board.contents.scores(LIVE) is None
    assert board.contents.map(LIVE, "error") is None
    assert board.contents.scores("mine") is not None
    board.update(lf.truth.disparity, views=lf.views[::-1].copy())
    assert board.contents.truth is None
    assert board.contents.scores("mine") is None
    assert board.contents.map(LIVE, "error") is None
    facts = {one["name"]: one for one in Facts(board).now()["results"]}
    assert (facts["mine"]["earlier"], facts[LIVE]["earlier"]) == (True, False)
    assert TRUTH not in facts


def test_what_is_unknown_does_not_stretch_scales() -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    disparity[0, 0], disparity[0, 1] = np.nan, np.inf
    contents = Contents(None, {"a": Entry(DisparityMap(disparity)), "b": Entry(DisparityMap(disparity * np.nan))})
    low, high = contents.limits("disparity")
    assert -1 <= low < high <= 1
    assert contents.extent("disparity") == pytest.approx((disparity[0, 2], 1))
    assert contents.extent("confidence") is None


def test_facts_are_plain_and_say_what_is_the_truth() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    board = Board()
    facts = Facts(board)
    assert json.loads(json.dumps(facts.now(), allow_nan=False))["size"] is None
    board.show(lf)
    (truth,) = json.loads(json.dumps(facts.now(), allow_nan=False))["results"]
    assert truth["isTruth"]
    assert truth["kinds"] == ["disparity", "depth"] if lf.geometry else ["disparity"]
    presets = {one["name"]: one for one in json.loads(json.dumps(fixed(), allow_nan=False))["presets"]}
    sections = {section["name"] for section in presets["paper"]["sections"]}
    assert "refinement" in sections
    assert "semi_global" not in sections  # that of another method


def test_readers_say_what_they_do(tmp_path: Path) -> None:
    write_hci(scenes.make("relief", grid=(3, 3), size=SIZE), tmp_path / "lf")
    board, said = Board(), list[str]()
    board.listen(lambda: said.append(board.loading[0] if board.loading else "done"))
    board.load([tmp_path / "lf"])
    assert said[0] == "Reading lf"
    assert "Reading lf: 9 of 9 views" in said
    assert said[-1] == "done"


def test_a_listener_that_fails_keeps_nobody_from_knowing() -> None:
    board, heard = Board(), list[bool]()
    board.listen(lambda: 1 / 0)
    end = board.listen(lambda: heard.append(True))
    board.tell()
    end()
    board.tell()
    assert heard == [True]


def test_pages_switch_what_a_stream_offers() -> None:
    board, switched = Board(), list[bool]()
    board.offer(pause=switched.append)
    board.switch("pause", True)
    assert board.stream.paused
    board.switch("pause", False)
    assert switched == [True, False]
    with pytest.raises(LightFieldError, match="record"):
        board.switch("record", True)


# --- what pages draw ---


@pytest.mark.parametrize(
    ("dtype", "white"), [(np.uint8, None), (np.uint16, None), (np.uint16, 4095), (np.float32, None)]
)
@pytest.mark.parametrize("level", [0, 1, 3])
def test_tiles_are_means_of_intensities(dtype: type, white: int | None, level: int) -> None:
    rng = np.random.default_rng(1)
    top = 1.0 if dtype is np.float32 else white or np.iinfo(dtype).max
    views = (rng.random((2, 30, 531, 3)) * top).astype(dtype)
    lf = LightField(views, [[0, 0], [1, 0]], white=white)
    tiles = [pictures.view_tile(lf, 1, level, column, 0) for column in range(2 if level == 0 else 1)]
    found = np.concatenate(tiles, axis=1) / float(np.iinfo(tiles[0].dtype).max)
    step = 2**level
    padded = np.pad(lf.image(1), ((0, -30 % step), (0, -531 % step), (0, 0)), mode="edge")
    means = padded.reshape(-(-30 // step), step, -(-531 // step), step, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found, means, atol=0.6 / np.iinfo(tiles[0].dtype).max)
    with pytest.raises(LightFieldError, match="no tile"):
        pictures.view_tile(lf, 1, level, 2, 0)
    with pytest.raises(LightFieldError, match="no view 2"):
        pictures.view_tile(lf, 2, level, 0, 0)


def test_maps_come_as_they_are() -> None:
    values = np.random.default_rng(1).standard_normal((600, 700)).astype(np.float32)
    values[3, 5] = np.nan
    np.testing.assert_array_equal(pictures.map_tile(values, 0, 1, 1), values[512:, 512:])
    np.testing.assert_array_equal(pictures.map_tile(values, 2, 0, 0), values[::4, ::4])


@pytest.mark.parametrize(("u", "v"), [(2, 1), (1, 0), (0, 0), (1, 1)])
def test_a_pixel_is_found_in_the_reference_view(u: int, v: int) -> None:
    """A near square before a far wall: behind it the wall is not seen, beside it nothing else is."""
    lf = wall(1.0)
    disparity = np.full(SIZE, -1.0, np.float32)
    disparity[8:16, 10:20] = 3.0
    disparity[0, 0] = np.nan
    contents = Contents(lf, {"mine": Entry(DisparityMap(disparity))})
    index = lf.index_of(v, u)
    for x, y in ((12, 10), (25, 20), (17, 14)):
        d = disparity[y, x]
        assert pictures.in_reference(contents, "mine", "final", index, x - d * (u - 1), y - d * (v - 1)) == (x, y)
    assert pictures.in_reference(contents, "none", "final", index, 3, 4) == ((3, 4) if (u, v) == (1, 1) else None)


def test_small_views_are_made_once_and_not_too_many_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    lf, made = scenes.make("boxes", grid=(5, 5), size=SIZE), list[Any]()
    make = pictures._small_view
    monkeypatch.setattr(pictures, "_small_view", lambda *asked: made.append(asked[1:]) or make(*asked))
    first = pictures.refocused(lf, 0.5, None, 2, *WHOLE)
    assert len(made) == len(lf.views)
    pictures.refocused(lf, 0.7, None, 2, *WHOLE)
    assert len(made) == len(lf.views)
    monkeypatch.setattr(pictures, "_ROOM", 4 * 12 * 10 * 3)
    np.testing.assert_array_equal(pictures.refocused(lf, 0.5, None, 2, *WHOLE), first)
    pictures.refocused(lf, 0.5, None, 1, *WHOLE)
    assert sum(view.nbytes for view, _ in pictures._small[lf].values()) <= pictures._ROOM


@pytest.mark.parametrize("size", [(40, 48), (37, 43)])
@pytest.mark.parametrize("factor", [2, 4, 8])
def test_small_views_are_in_line_with_large_ones(size: tuple[int, int], factor: int) -> None:
    ramp = np.add.outer(np.arange(size[0]), 2.0 * np.arange(size[1]))[..., None].astype(np.float32)
    small = pictures._middles(ramp, factor)
    assert small.shape == (-(-size[0] // factor), -(-size[1] // factor), 1)
    whole = size[0] // factor, size[1] // factor  # those at the right and the lower end are of fewer pixels
    np.testing.assert_array_equal(
        small[: whole[0], : whole[1]], pictures._reduced(ramp, factor)[: whole[0], : whole[1]]
    )


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("masked", [False, True])
def test_computed_tiles_fit_together_to_the_whole_picture(level: int, masked: bool) -> None:
    """Points that other surfaces hide, colours from beyond a tile, and sides that no tile divides."""
    lf = scenes.make("boxes", grid=(5, 5), size=(101, 131))
    if masked:
        valid = np.ones((len(lf.views), *lf.size), np.bool_)
        valid[3, 30:60, 20:90] = False
        lf = replace(lf, valid=valid)
    truth = lf.reference_truth()
    assert truth is not None
    disparity = truth.disparity.copy()
    disparity[40:44, 50:58] = np.nan
    disparity[60:, 20:] = np.where(np.arange(111) % 30 < 12, 4, -4)  # hides what is 16 pixels beside
    contents = Contents(lf).with_entry("map", Entry(DisparityMap(disparity)))
    rows, columns = (-(-side // (32 << level)) for side in lf.size)
    for tile in (
        lambda *place: pictures.refocused(lf, 1.3, None, level, *place),
        lambda *place: pictures.sharp(contents, "map", "final", level, *place),
    ):
        lines = [np.concatenate([tile(column, row, 32) for column in range(columns)], axis=1) for row in range(rows)]
        whole = tile(*WHOLE).astype(int)
        assert whole.shape[:2] == (-(-101 // 2**level), -(-131 // 2**level))
        np.testing.assert_allclose(np.concatenate(lines), whole, atol=1)


def test_levels_end_where_one_pixel_is_the_whole_picture() -> None:
    lf = wall(1.0)
    assert pictures.view_tile(lf, 0, 5, 0, 0).shape == (1, 1, 1)
    for level in (-1, 6, 16):  # of 65536 x 65536 pixels
        with pytest.raises(LightFieldError, match="no tile"):
            pictures.view_tile(lf, 0, level, 0, 0)
    for side in (0, pictures.TILE + 1):
        with pytest.raises(LightFieldError, match="no tile"):
            pictures.refocused(lf, 0.0, None, 0, 0, 0, side)


_EVERYTHING = """
import sys
from lfgpu import Viewer, estimate_depth, scenes
from lfgpu.viewer import pictures, saving
from lfgpu.viewer.space import Space
lf = scenes.make("boxes", grid=(5, 5), size=(40, 48))
with Viewer(lf, port=0) as viewer:
    before = set(sys.modules)
    pictures.prepare()
    for preset in ("fast", "paper"):
        viewer.add(estimate_depth(lf, config=preset), name=preset)
    limits, colours = (-1.0, 1.0), "viridis"
    saving.figure(viewer.contents, "fast", "disparity", "final", colours=colours, limits=limits)
    saving.saved(viewer.contents, "fast", "final", ".ply")
    Space(viewer, print).close()
ours = {"lfgpu", "scipy", "matplotlib", "viser", "trimesh", "plyfile"}
print(sorted(name for name in set(sys.modules) - before if name.split(".")[0] in ours))
"""


def test_nothing_is_imported_once_kernels_are_loaded() -> None:
    """Both parse Python, which two threads must not do: pictures, estimates and 3D come in threads of their own."""
    found = subprocess.run([sys.executable, "-c", _EVERYTHING], capture_output=True, text=True, timeout=300)
    assert found.stdout.splitlines()[-1:] == ["[]"], found.stdout + found.stderr


def test_a_smaller_lens_takes_fewer_views() -> None:
    lf = wall(1.0)
    views = lf.views.copy()
    views[lf.index_of(0, 0)] = 1.0
    lf = LightField.from_grid(views.reshape(3, 3, *SIZE, 1))
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(refocus(lf, 5.0, aperture=0.5), reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, 1.0, aperture=1.0), reference, atol=1e-4)
    assert np.abs(refocus(lf, 1.0, aperture=1.5) - reference).mean() > 0.01
    with pytest.raises(LightFieldError, match="aperture"):
        refocus(lf, 1.0, aperture=-1)


def test_a_surface_has_no_sheets_across_edges() -> None:
    disparity = np.zeros(SIZE, np.float32)
    disparity[:, 16:] = 2.0
    disparity[5, 5] = np.nan
    cloud = shown_cloud(DisparityMap(disparity), np.zeros((*SIZE, 3), np.uint8))
    triangles = surface(cloud, disparity)
    sides = (cloud.pixels[:, 0] < 16)[triangles]
    assert (sides.all(axis=1) | ~sides.any(axis=1)).all()
    assert len(triangles) == 2 * ((SIZE[0] - 1) * (SIZE[1] - 2) - 4)
    towards = np.cross(*(cloud.points[triangles[:, k]] - cloud.points[triangles[:, 0]] for k in (1, 2)))
    assert (towards[:, 2] < 0).all()  # their fronts face the camera


def in_frame(cloud: Cloud, points: np.ndarray, aspect: float, cameras: np.ndarray | None = None) -> float:
    """How far from the middle of the first picture points are: 1 is the border. All must lie before the eye."""
    eye, target, fov = framed(cloud, aspect, cameras)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross([0, 1, 0], forward)
    right /= np.linalg.norm(right)
    relative = points - eye
    deep = relative @ forward
    assert (deep > 0).all()
    up = np.abs(relative @ np.cross(forward, right)) / deep
    beside = np.abs(relative @ right) / deep / aspect
    return float(max(up.max(), beside.max()) / np.tan(fov / 2))


@pytest.mark.parametrize("aspect", [0.5, 2.0])
@pytest.mark.parametrize(
    ("size", "near", "far", "unit"),
    [
        (SIZE, -1.0, 1.0, 1.0),
        ((30, 160), -1.0, 1.0, 1.0),  # wide
        (SIZE, -1.5, 60.0, 1.0),  # deep
        (SIZE, -1.0, 1.0, 1e-4),  # tiny
    ],
    ids=["ramp", "wide", "deep", "tiny"],
)
def test_the_first_eye_sees_the_whole_cloud(
    size: tuple[int, int], near: float, far: float, unit: float, aspect: float
) -> None:
    disparity = np.linspace(near, 1, size[0] * size[1], dtype=np.float32).reshape(size)
    disparity[-size[0] // 5 :] = far  # what stands in front
    geometry = Geometry(50.0, 0.1 * unit, 2.0 * unit)
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), np.zeros((*size, 3), np.uint8))
    assert 0.85 < in_frame(cloud, cloud.points, aspect) < 1.05


@pytest.mark.parametrize("baseline", [0.01, 0.1, 2.0])
def test_the_first_eye_sees_all_cameras(baseline: float) -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    geometry = Geometry(50.0, baseline, 2.0)
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), np.zeros((*SIZE, 3), np.uint8))
    cameras = np.array([(baseline * u, baseline * v, 0.0) for u in (-4, 0, 4) for v in (-4, 0, 4)])
    assert in_frame(cloud, cameras, 1.5, cameras) < 1.0


@pytest.mark.parametrize("suffix", [".npz", ".pfm", ".exr", ".ply", ".png", ".tif"])
def test_results_are_saved_as_the_package_saves_them(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR") if suffix == ".exr" else None
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    contents = Contents(
        lf, {"mine": Entry(DisparityMap(np.full(SIZE, 0.5, np.float32), np.full(SIZE, 0.9, np.float32)))}
    )
    path = tmp_path / f"saved{suffix}"
    path.write_bytes(saving.saved(contents, "mine", "final", suffix))
    np.testing.assert_allclose(read_map(path), 0.5, atol=1e-4)
    for wrong in (".jpg", f"/../../escaped{suffix}", ""):
        with pytest.raises(LightFieldError, match="cannot be written"):
            saving.saved(contents, "mine", "final", wrong)
    with pytest.raises(LightFieldError, match="no result"):
        saving.saved(contents, "other", "final", suffix)


# --- the viewer itself ---


def test_updates_come_from_any_thread_and_wrong_ones_are_refused() -> None:
    pytest.importorskip("viser")
    from lfgpu.viewer import Viewer

    lf = wall(1.0)
    with Viewer(lf, port=0) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")
        buffer = np.zeros(SIZE, np.float32)
        pushers = [threading.Thread(target=viewer.update, args=(buffer,)) for _ in range(4)]
        for pusher in pushers:
            pusher.start()
        for pusher in pushers:
            pusher.join()
        buffer += 9  # its owner writes the next frame to it
        assert not viewer.contents.entries[LIVE].disparity.any()
        viewer.update(buffer, views=lf.views)
        with pytest.raises(LightFieldError, match="what is shown has 32 x 24"):
            viewer.update(np.zeros((5, 6)))
        with pytest.raises(LightFieldError, match="confidence must be"):
            viewer.update(buffer, np.zeros((2, 2)))
        with pytest.raises(LightFieldError, match="views must be"):
            viewer.update(buffer, views=lf.views[1:])
        with pytest.raises(LightFieldError, match=r"\[y, x\]"):
            viewer.update(np.zeros(3))
    viewer.close()  # twice does no harm


def test_an_estimate_can_be_stopped_and_made_again() -> None:
    from lfgpu.methods import preset
    from lfgpu.viewer.solving import Progress, Request, Solver

    said: list[Progress] = []
    done = threading.Event()
    solver = Solver(said.append, lambda *_: done.set())
    request = Request(scenes.make("relief", grid=(3, 3), size=SIZE), preset("paper"), (-2, 2), "mine")
    assert solver.start(request)
    assert not solver.start(request)
    solver.stop()
    solver.close()
    assert said[-1].text == "stopped"
    assert not done.is_set()
    assert solver.start(request)
    assert solver._thread is not None
    solver._thread.join(60)
    assert done.is_set()
    assert said[-1].text.startswith("mine: done in")
    assert not solver.progress.busy
    shares = [progress.share for progress in said[said.index(next(p for p in said if "local" in p.text)) :]]
    assert max(shares) == 100


def test_an_estimate_that_fails_says_why() -> None:
    from lfgpu.methods import preset
    from lfgpu.viewer.solving import Progress, Request, Solver

    said: list[Progress] = []
    solver = Solver(said.append, lambda *_: pytest.fail("there is no result"))
    assert solver.start(Request(wall(1.0), preset("fast"), (-900, 900)))
    assert solver._thread is not None
    solver._thread.join(60)
    assert "give smaller disparities" in said[-1].text
    assert not said[-1].busy


# --- the command ---


def view(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["view", *map(str, arguments), "--port", "0"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def test_the_command_says_where_to_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser")
    write_pfm(tmp_path / "map.pfm", np.zeros((5, 6)))
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda _: None)
    code, said, err = view(tmp_path / "map.pfm")
    assert (code, err) == (0, "")
    assert re.search(r"http://127\.0\.0\.1:\d+/[\w-]{32}/ with a browser", said)
    assert viser.__name__ not in said


def test_the_command_reads_as_depth_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    np.save(tmp_path / "views.npy", lf.views[:6])
    write_pfm(tmp_path / "map.pfm", np.zeros(SIZE))
    shown: list[Contents] = []
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda viewer: shown.append(viewer.contents))
    code, _, err = view(tmp_path / "views.npy", tmp_path / "map.pfm", "--grid", "2x3", "--flip", "u")
    assert (code, err) == (0, "")
    assert shown[0].lf is not None
    assert shown[0].lf.grid_shape == (2, 3)
    np.testing.assert_array_equal(shown[0].lf.view(0, 0), lf.view(0, 2))
    assert list(shown[0].entries) == ["map"]
    code, said, err = view(tmp_path / "map.pfm", "--grid", "2x3")
    assert (code, said) == (1, "")
    assert "map.pfm" in err


@pytest.mark.parametrize(
    ("name", "words"), [("nowhere", "does not exist"), ("empty", "an empty folder"), ("bad.pfm", "bad.pfm")]
)
def test_what_cannot_be_shown_is_a_sentence(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.pfm").write_bytes(b"PF?")
    code, _, err = view(tmp_path / name)
    assert code == 1
    assert words in err
    assert err.count("\n") == 1


def test_the_command_says_where_to_look_before_all_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading waits here until the address was said."""
    said = threading.Event()
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda _: None)
    monkeypatch.setattr(
        "lfgpu.viewer.board.opened_all", lambda *_, **__: Contents(wall(1.0)) if said.wait(60) else None
    )
    monkeypatch.setattr("lfgpu.cli.view.typer.echo", lambda text: said.set() if "Open http://" in text else None)
    write_pfm(tmp_path / "map.pfm", np.zeros((5, 6)))
    assert view(tmp_path / "map.pfm")[0] == 0
    assert said.is_set()


def test_without_viser_there_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from lfgpu.viewer import Viewer

    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(LightFieldError, match=r"pip install -e '\.\[viewer\]'"):
        Viewer()


def test_the_address_is_known_before_anything_heavy_is_imported() -> None:
    code = (
        "import sys\n"
        "from lfgpu.viewer.place import Place\n"
        "place = Place(0)\n"
        "assert place.url.startswith('http://127.0.0.1:')\n"
        "assert not {'numpy', 'tornado', 'scipy'} & sys.modules.keys()\n"
        "import lfgpu.viewer.server, lfgpu.viewer.web\n"
        "assert not {'scipy', 'matplotlib', 'warp', 'viser', 'h5py', 'dask'} & sys.modules.keys()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_who_connects_early_is_answered_later() -> None:
    """The address is printed before the server is there."""
    pytest.importorskip("tornado")
    pytest.importorskip("viser")
    place = Place(0)
    with socket.create_connection(("127.0.0.1", place.port), 10) as early:
        early.sendall(f"GET /{place.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{place.port}\r\n\r\n".encode())
        with Viewer(port=place) as viewer:
            assert viewer.url == place.url
            assert early.recv(100).startswith(b"HTTP/1.1 200")


def test_a_port_that_is_taken_is_passed_over() -> None:
    first = Place(0)
    second = Place(first.port)
    assert second.port > first.port
    with pytest.raises(LightFieldError, match="there is no port 65536"):
        Place(65536)
    for place in (first, second):
        place.socket.close()


def test_pictures_are_of_the_frame_that_a_page_was_told() -> None:
    board = Board()
    board.show(wall(1.0))
    facts = Facts(board)
    told, kept = facts.newest()
    lf = board.contents.lf
    assert lf is not None
    board.update(np.zeros(SIZE), views=np.zeros_like(lf.views))
    assert facts.contents(told["revision"]) is kept
    newer, contents = facts.newest()
    assert newer["revision"] != told["revision"]
    assert facts.contents(newer["revision"]) is contents is board.contents
    del kept, lf
    gc.collect()
    assert facts.contents(told["revision"]) is None  # nobody keeps it


def test_unknown_rates_are_not_told() -> None:
    board = Board()
    board.show(wall(1.0))
    board.update(np.zeros(SIZE), rate=float("nan"), latency=0.25, dropped=3)
    stream = json.loads(json.dumps(Facts(board).now(), allow_nan=False))["stream"]
    assert (stream["rate"], stream["latency"], stream["dropped"]) == (None, 0.25, 3)


@pytest.mark.parametrize(("low", "high", "bins"), [(1.0, 1.0, 5), (0.0, 1.0, 0), (0.0, 1.0, 10**6)])
def test_a_distribution_needs_bins(low: float, high: float, bins: int) -> None:
    with pytest.raises(LightFieldError, match="there are no"):
        histogram(np.zeros(SIZE, np.float32), low, high, bins)


def test_what_is_undefined_or_beyond_is_in_no_bin() -> None:
    values = np.array([[0.1, 0.1, 0.9, 5.0, np.nan]], np.float32)
    np.testing.assert_allclose(histogram(values, 0.0, 1.0, 2), [50, 25])

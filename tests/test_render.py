"""Rendered views against the scene itself, refocused and all-in-focus images, and their files."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import tifffile
from PIL import Image
from walls import SIZE as WALL, wall

import lfgpu
from lfgpu import scenes
from lfgpu._backends import open_device
from lfgpu.cameras.points import visible
from lfgpu.data import DisparityMap, LightField, ViewsResult
from lfgpu.errors import LightFieldError
from lfgpu.io.frames import check_frames_path, write_frames, write_image
from lfgpu.methods import method_of
from lfgpu.pipelines.all_views import estimate_all_views
from lfgpu.viz.refocusing import all_in_focus, refocus
from lfgpu.viz.rendering import filled_from_beside
from tests.made import masked

SIZE = (80, 96)


def psnr(image: np.ndarray, true: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((image - true) ** 2)))


@cache
def recorded(name: str = "boxes") -> LightField:
    return scenes.make(name, grid=(5, 5), size=SIZE, dtype=np.float32)


@cache
def kept(name: str = "boxes") -> LightField:
    """Every second row and column of the views."""
    lf = recorded(name)
    return lf.subset([n for n, (u, v) in enumerate(lf.positions) if u % 2 == 0 and v % 2 == 0])


@cache
def maps(name: str = "boxes") -> ViewsResult:
    config = method_of("accurate").for_rendering
    return estimate_all_views(kept(name), config=config, disparity_range=(-1.6, 1.7))


@cache
def true_maps() -> ViewsResult:
    lf, estimated = kept(), maps()
    disparities = np.stack(
        [scenes.true_disparity("boxes", int(v), int(u), grid=(5, 5), size=SIZE) for u, v in lf.positions]
    )
    return replace(estimated, disparities=disparities.astype(np.float32))


# --- new views ---


@pytest.mark.parametrize("place", [(1, 1), (2, 1), (3, 4)])
def test_views_that_were_left_out_are_rendered_better_than_by_their_neighbours(place: tuple[int, int]) -> None:
    lf, (row, column) = kept(), place
    true = recorded().image(recorded().index_of(row, column))
    distance = np.hypot(*(lf.positions - (column, row)).T)
    neighbours = np.mean([lf.image(n) for n in np.flatnonzero(distance < distance.min() + 1e-6)], axis=0)
    for known_maps in (maps(), true_maps()):
        rendered = lfgpu.render_view(lf, known_maps, row, column)
        assert rendered.image.dtype == np.float32
        assert rendered.image.shape == (*SIZE, 3)
        assert psnr(rendered.image, true) > psnr(neighbours, true) + 3
        assert rendered.known.mean() > 0.98


def test_a_recorded_view_is_rendered_as_it_is_and_a_new_one_near_its_truth() -> None:
    rendered = lfgpu.render_view(kept(), true_maps(), 3.0, 1.0)
    truth = scenes.true_disparity("boxes", 3, 1, grid=(5, 5), size=SIZE)
    assert np.mean(np.abs(rendered.disparity - truth) > 0.07) < 0.05
    assert rendered.position == (1.0, 3.0)
    lf = kept()
    rendered = lfgpu.render_view(lf, maps(), *lf.positions[3, ::-1], sources=1)
    np.testing.assert_allclose(rendered.image, lf.image(3), atol=1e-4)
    assert rendered.known.all()


def test_beyond_the_grid_there_are_no_holes_and_what_is_filled_is_told() -> None:
    lf = recorded()
    inner = [n for n, (u, v) in enumerate(lf.positions) if 1 <= u <= 3 and 1 <= v <= 3]
    disparities = np.stack([scenes.true_disparity("boxes", n // 5, n % 5, grid=(5, 5), size=SIZE) for n in inner])
    known = replace(maps(), disparities=disparities.astype(np.float32), positions=lf.positions[inner])
    for row, column in ((2, 4), (0, 0)):
        true, nearest = lf.view(row, column), lf.view(np.clip(row, 1, 3), np.clip(column, 1, 3))
        rendered = lfgpu.render_view(lf.subset(inner), known, row, column)
        assert np.isfinite(rendered.image).all()
        assert rendered.image[~rendered.known].mean() > 0.5 * true.mean()  # filled, not black
        assert 0.002 < (~rendered.known).mean() < 0.08
        assert psnr(rendered.image, true) > psnr(nearest, true) + 3
        assert psnr(rendered.image[rendered.known], true[rendered.known]) > psnr(nearest, true) + 4


def test_masked_pixels_are_not_used() -> None:
    lf = kept()
    left = masked(lf, np.s_[:, :, :12])
    dark = replace(left, views=np.where(left.valid[..., None], lf.views, 0))
    rendered = lfgpu.render_view(dark, maps(), 1.0, 2.0)
    unmasked = lfgpu.render_view(lf, maps(), 1.0, 2.0)
    where = rendered.known & unmasked.known
    assert 0.7 < where.mean() < 0.95
    assert psnr(rendered.image[where], unmasked.image[where]) > 35
    assert not rendered.known[:, :8].any()


def test_grey_views_and_rows_of_cameras() -> None:
    lf = LightField(recorded().views[10:15, ..., :1], recorded().positions[10:15])
    result = estimate_all_views(lf, config="fast", disparity_range=(-1.6, 1.7))
    assert lfgpu.render_view(lf, result, 2.0, 1.5).image.shape == (*SIZE, 1)


def test_what_cannot_be_rendered_is_refused() -> None:
    lf, known = kept(), maps()
    for maps_, position, words in (
        (known, ("1", 1.0), "row must be a number"),
        (known, (1.0, np.nan), "column must be a number"),
        (known, (1.0, 100.0), "row 1, column 100 is too far away"),
        (replace(known, disparities=known.disparities[:, 1:]), (1.0, 1.0), "79 x 96 pixels"),
        (replace(known, positions=known.positions + 1), (1.0, 1.0), "other camera positions"),
    ):
        with pytest.raises(LightFieldError, match=words):
            lfgpu.render_view(lf, maps_, *position)
    with pytest.raises(LightFieldError, match="sources"):
        lfgpu.Renderer(lf, known, sources=0)
    with pytest.raises(LightFieldError, match=r"make them with lfgpu.estimate_all_views\(lf\)"):
        lfgpu.render_view(lf, known.disparities)  # type: ignore[arg-type]
    assert lfgpu.render_view(lf, known).position == tuple(lf.positions[lf.reference_index])


# --- focus ---


@pytest.mark.parametrize("axis", [0, 1], ids=["du", "dv"])
def test_refocus_shifts_each_view_the_way_its_camera_moved(axis: int) -> None:
    """Two views of a point, 3 px apart along one axis: both signs and both axes have their own."""
    views = np.zeros((2, 20, 24, 1), np.float32)
    views[0, 10, 12] = 1
    moved = (10, 12 - 3) if axis == 0 else (10 - 3, 12)  # at (x - d du, y - d dv) in the view one step on, d = 3
    views[(1, *moved)] = 1
    positions = np.array([[0.0, 0.0], [1.0, 0.0] if axis == 0 else [0.0, 1.0]])
    lf = LightField(views, positions, reference=0)
    sharp = lfgpu.refocus(lf, 3.0)[..., 0]
    assert sharp[10, 12] == pytest.approx(1, abs=1e-3)
    assert lfgpu.refocus(lf, -3.0)[10, 12, 0] == pytest.approx(0.5, abs=1e-3)


def test_refocus_leaves_out_what_lies_beyond_the_frame_or_is_masked() -> None:
    views = np.full((3, 3, 20, 24), 0.5, np.float32)
    valid = np.ones((9, 20, 24), np.bool_)
    valid[4, 3:6, 3:6] = False
    views.reshape(9, 20, 24)[~valid] = 0
    lf = LightField.from_grid(views, valid=valid)
    np.testing.assert_allclose(lfgpu.refocus(lf, 2.3), 0.5, atol=0.02)
    nothing = LightField.from_grid(views, valid=np.zeros_like(valid))
    assert (lfgpu.refocus(nothing, 1.0) == 0).all()
    with pytest.raises(LightFieldError, match="must be a number"):
        lfgpu.refocus(lf, float("nan"))


def test_all_in_focus_has_less_noise_and_stays_sharp() -> None:
    noisy = scenes.make("boxes", grid=(5, 5), size=SIZE, dtype=np.float32, noise=0.03)
    clean = recorded()
    middle = clean.reference_index
    true = clean.image(middle)
    result = lfgpu.DisparityMap(noisy.truth.disparity, position=noisy.truth.position)
    found = lfgpu.all_in_focus(noisy, result)
    assert psnr(found, true) > psnr(noisy.image(middle), true) + 5
    with pytest.raises(LightFieldError, match="the map belongs to the view at row 2, column 2"):
        lfgpu.all_in_focus(noisy.with_reference(0), result)
    with pytest.raises(LightFieldError, match="the map must be 80 x 96 as the views"):
        lfgpu.all_in_focus(noisy, lfgpu.DisparityMap(np.zeros((3, 3), np.float32)))


@pytest.mark.parametrize("slope", [-0.4, 0.0, 0.2, 0.45])
@pytest.mark.parametrize("offset", [-1.0, 1.0])
def test_a_surface_hides_what_lands_behind_it_and_nothing_of_itself(slope: float, offset: float) -> None:
    y, x = np.indices((5, 60))
    disparity = (slope * (x - 30) + 0.013).astype(np.float32)
    near = (x >= 25) & (x < 35) & (slope == 0)  # whole pixels nearer than the wall
    disparity[near] = 4.013
    tolerance = 1.001 * abs(slope) / abs(1 - slope * offset) + 0.1
    offsets = np.array([[0.0, 0.0], [offset, 0.0]])
    front, seen = visible(disparity, offsets, y, x, open_device("reference"), tolerance=tolerance)
    assert front.all()
    place = x - disparity * offset
    covered = np.isin(np.round(place), np.round(place[0, near[0]])) & ~near
    np.testing.assert_array_equal(seen, (place >= 0) & (place <= 59) & ~covered)


def test_all_in_focus_where_the_map_or_the_view_knows_nothing() -> None:
    lf = recorded()
    disparity, valid = lf.truth.disparity.copy(), np.ones(lf.views.shape[:3], np.bool_)
    disparity[30:34, 40:44] = np.nan
    valid[lf.reference_index, 10:13, 10:13] = False
    views = np.where(valid[..., None], lf.views, 0)
    found = lfgpu.all_in_focus(replace(lf, views=views, valid=valid), lfgpu.DisparityMap(disparity))
    true = lf.image(lf.reference_index)
    np.testing.assert_allclose(found[31, 41], true[31, 41], atol=1e-4)
    assert np.abs(found - true)[10:13, 10:13].mean() < 0.05


# --- files ---


def frames(count: int = 3) -> list[np.ndarray]:
    y, x = np.mgrid[:33, :48] / 48
    return [np.stack([x, y, np.full_like(x, n / count)], axis=-1).astype(np.float32) for n in range(count)]


def test_images_are_stored_as_they_are(tmp_path: Path) -> None:
    (image,) = frames(1)
    for dtype, most in ((np.uint8, 255), (np.uint16, 65535)):
        write_image(image, tmp_path / "a.png", dtype=dtype)
        stored, _ = lfgpu.io.images.read_image(tmp_path / "a.png")
        assert stored.dtype == dtype
        np.testing.assert_allclose(stored / most, image, atol=0.51 / most)
    write_image(image, tmp_path / "a.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), image)


def test_films(tmp_path: Path) -> None:
    write_frames(frames(), tmp_path / "a.gif", fps=10)
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"], film.info["loop"]) == (3, (48, 33), 100, 0)
        np.testing.assert_allclose(np.asarray(film.convert("RGB")) / 255, frames()[0], atol=0.1)
    write_frames(frames(), tmp_path / "a.mp4", fps=10)
    read = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    about = next(read)
    assert (about["size"], about["fps"]) == ((48, 32), 10)  # H.264 wants even sizes
    shown = [np.frombuffer(frame, np.uint8).reshape(32, 48, 3) / 255 for frame in read]
    assert len(shown) == 3
    np.testing.assert_allclose(shown[2], frames()[2][:32], atol=0.12)
    write_frames(frames(), tmp_path / "a")
    assert [file.name for file in sorted((tmp_path / "a").iterdir())] == [f"frame_{n:03d}.png" for n in range(3)]


def test_a_film_that_the_disk_has_no_room_for_is_refused_in_one_sentence(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    noise = [rng.random((240, 320, 3), np.float32)] * 100
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        with pytest.raises(LightFieldError, match=r"a\.mp4 cannot be written: ffmpeg could not .*the disk is full\.$"):
            write_frames(noise, tmp_path / "a.mp4")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not any(tmp_path.iterdir())


def test_films_do_not_mix(tmp_path: Path) -> None:
    for count in (3, 3):
        write_frames(frames(count), tmp_path / "a")
    for call in (lambda: write_frames(frames(2), tmp_path / "a"), lambda: check_frames_path(tmp_path / "a", 2)):
        with pytest.raises(
            LightFieldError, match=r"holds frame_002\.png of another light field or film; choose an empty"
        ):
            call()
    assert len(list((tmp_path / "a").iterdir())) == 3


def test_other_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LightFieldError, match=r"\.png or \.tif"):
        write_image(frames(1)[0], tmp_path / "a.jpg")
    with pytest.raises(LightFieldError, match=r"\.gif or \.mp4"):
        write_frames(frames(), tmp_path / "a.avi")
    with pytest.raises(LightFieldError, match="frames per second"):
        write_frames(frames(), tmp_path / "a.gif", fps=0)
    with pytest.raises(
        LightFieldError, match=r"a\.mp4 cannot be written: its images are 1 px wide or high; write \.gif"
    ):
        write_frames([frame[:1] for frame in frames()], tmp_path / "a.mp4")
    for library in ("imageio_ffmpeg", "tifffile"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(LightFieldError, match=r"lfgpu\[video\]"):
        write_frames(frames(), tmp_path / "a.mp4")
    with pytest.raises(LightFieldError, match=r"lfgpu\[tiff\]"):
        write_image(frames(1)[0], tmp_path / "a.tif")


# --- beyond the cameras ---


def test_what_hides_a_surface_is_not_seen_there_a_second_time() -> None:
    """Far beyond the cameras there are strips beside things that no view shows: they look like what is behind."""
    lf = recorded()
    inner = lf.subset([n for n, (u, v) in enumerate(lf.positions) if u <= 2])
    disparities = [scenes.true_disparity("boxes", int(v), int(u), grid=(5, 5), size=SIZE) for u, v in inner.positions]
    known_maps = replace(
        maps(),
        disparities=np.stack(disparities).astype(np.float32),
        confidences=None if maps().confidences is None else np.ones((len(inner.views), *SIZE), np.float32),
        positions=inner.positions,
        keys=(0,),
    )
    rendered = lfgpu.render_view(inner, known_maps, 2.0, 4.0)
    true, truth = lf.image(lf.index_of(2, 4)), scenes.true_disparity("boxes", 2, 4, grid=(5, 5), size=SIZE)
    x = np.arange(SIZE[1])
    inside = x - truth * -2 <= SIZE[1] - 1  # seen by the last column of cameras, if nothing is in the way
    strips = inside & ~rendered.known
    assert 0.001 < strips.mean() < 0.05
    assert np.abs(rendered.image - true)[strips].mean() < 0.2
    assert np.median(np.abs(rendered.disparity - truth)[strips]) < 0.3


def test_unknown_pixels_of_maps_leave_no_hole_in_the_picture() -> None:
    known_maps = true_maps()
    disparities = known_maps.disparities.copy()
    disparities[:, :12, :15] = np.nan
    rendered = lfgpu.render_view(kept(), replace(known_maps, disparities=disparities), 1.0, 3.0)
    assert np.isfinite(rendered.image).all()
    assert not rendered.known[:8, :10].any()


def test_holes_take_the_colour_of_what_is_no_nearer() -> None:
    disparity = np.zeros((9, 12), np.float32)
    disparity[:, :4] = 2.0  # a thing in front
    image = np.zeros((9, 12, 3), np.float32)
    image[:, :4, 0], image[:, 4:, 2] = 1.0, 1.0
    hidden = np.zeros((9, 12), np.bool_)
    hidden[2:7, 4:8] = True
    image[hidden] = (1.0, 0.0, 0.0)  # what hides it
    filled = filled_from_beside(image, disparity, hidden, tolerance=0.5)
    np.testing.assert_array_equal(filled[hidden], np.broadcast_to([0, 0, 1], (20, 3)))
    np.testing.assert_array_equal(filled[~hidden], image[~hidden])
    alone = filled_from_beside(image, np.where(hidden, -5, disparity).astype(np.float32), hidden, tolerance=0.5)
    assert (alone[hidden] > 0).any(axis=1).all()  # from what is nearer if there is nothing else


@pytest.mark.parametrize("disparity", [1.0, -2.0, 0.0])
@pytest.mark.parametrize("valid", [False, True])
def test_what_is_in_focus_looks_as_in_the_reference(disparity: float, valid: bool) -> None:
    lf = wall(disparity, valid=valid)
    sharp, blurred = refocus(lf, disparity), refocus(lf, disparity + 2)
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(sharp, reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, disparity, order=1), reference, atol=1e-5)
    assert np.abs(blurred - reference).mean() > 0.05


def test_there_are_two_orders() -> None:
    lf = wall(1.0)
    with pytest.raises(LightFieldError, match="order"):
        refocus(lf, 0.0, order=2)
    with pytest.raises(LightFieldError, match="order"):
        all_in_focus(lf, DisparityMap(np.zeros(WALL, np.float32)), order=2)


def test_a_smaller_lens_takes_fewer_views() -> None:
    lf = wall(1.0)
    views = lf.views.copy()
    views[lf.index_of(0, 0)] = 1.0
    lf = LightField.from_grid(views.reshape(3, 3, *WALL, 1))
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(refocus(lf, 5.0, aperture=0.5), reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, 1.0, aperture=1.0), reference, atol=1e-4)
    assert np.abs(refocus(lf, 1.0, aperture=1.5) - reference).mean() > 0.01
    with pytest.raises(LightFieldError, match="aperture"):
        refocus(lf, 1.0, aperture=-1)

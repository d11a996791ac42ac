"""Raw lenslet captures: the grid, the views and the disparity that made a capture come out of it again."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lenslet_samples import Camera, Sample, capture, eight_bit
from numpy.typing import NDArray
from PIL import Image
from samples import refusal

import lfgpu
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read, recognise
from lfgpu.io.lenslet import read_lenslet
from lfgpu.io.lenslet.bayer import PATTERNS, demosaic, green_diagonal, transposed
from lfgpu.io.lenslet.decode import decode, write_decoded
from lfgpu.io.lenslet.lattice import Microlenses
from lfgpu.io.lenslet.microlenses import find_microlenses, is_upright
from lfgpu.io.lenslet.spectrum import find_peaks
from lfgpu.io.lenslet.vignetting import field_gains
from lfgpu.scenes import make

CAMERAS = [
    Camera(),
    Camera(pitch=7.4, degrees=-2.5, bayer="grbg"),
    Camera(pitch=14.29, degrees=0.02, size=(700, 720), bayer="gbrg"),
    Camera(pitch=9.93, degrees=8, bayer="rggb"),
    Camera(pitch=9.3, degrees=1.5, square=True),
    Camera(pitch=12.4, degrees=-4, square=True, bayer="grbg"),
]


@pytest.fixture(scope="module")
def scene() -> LightField:
    """9 x 9 views, a view more to each side than a microlens 9.3 px wide shows."""
    return make("planes", grid=(9, 9), size=(72, 80), disparity_range=(-0.6, 0.6), seed=3)


@pytest.fixture(scope="module")
def sample(scene: LightField) -> Sample:
    return capture(scene, Camera(), noise=0.01)


def save(path: Path, values: NDArray[np.float64]) -> Path:
    Image.fromarray(eight_bit(values)).save(path)
    return path


def saved(sample: Sample, folder: Path) -> tuple[Path, Path]:
    return save(folder / "raw.png", sample.raw), save(folder / "white.png", sample.white)


def linear(about: dict[str, Any], view: NDArray[np.uint16]) -> NDArray[np.float64]:
    return about["values"]["white_level"] * (view / 65535.0) ** 2


# --- the grid ---


def spots(lenses: Microlenses, size: tuple[int, int], *, width: float = 0.28, noise: float = 0.1) -> Any:
    """A picture of round spots at the places of a lattice, `width` (standard deviation) in pitches."""
    x, y = np.arange(size[1], dtype=np.float32), np.arange(size[0], dtype=np.float32)
    k, row = lenses.nearest(x, y)
    centres = lenses.centres(k.astype(float), row.astype(float))
    distance = np.hypot(x - centres[..., 0], y[:, None] - centres[..., 1]) / lenses.pitch
    light = np.exp(-(distance**2) / (2 * width**2))
    return (light * (1 + np.random.default_rng(0).normal(0, noise, size))).astype(np.float32)


def off_centres(found: Microlenses, true: Microlenses, size: tuple[int, int]) -> float:
    """Root mean square distance of the true centres inside a picture from those found, pixels."""
    k, row = true.inside(size, 0)
    return off(found, true.centres(k.astype(float), row.astype(float)))


def off(found: Microlenses, centres: NDArray[np.float64]) -> float:
    """Root mean square distance of some of true centres from the nearest ones of a grid, pixels."""
    some = centres[:: max(1, len(centres) // 300)]
    near = np.array([found.near(centre).origin for centre in some])
    return float(np.sqrt(((near - some) ** 2).sum(1).mean()))


def lattice(pitch: float, degrees: float, *, square: bool, slant: tuple[float, float] = (0, 0)) -> Microlenses:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    down = [0.0, pitch] if square else [pitch / 2, pitch * np.sqrt(3) / 2]
    steps = np.array([[pitch, 0.0], down]) @ np.array([[c, s], [-s, c]])
    return Microlenses(np.array([260.3, 251.8]), steps[0], steps[1], square, np.array(slant, float))


@pytest.mark.parametrize(
    "true",
    [
        lattice(7.7, -2, square=True, slant=(8e-4, 3e-5)),
        lattice(12.3, 20, square=True),
        lattice(11.1, 5, square=False, slant=(-3e-4, 5e-4)),
        lattice(21.2, 1, square=False),
        lattice(55.0, 0, square=False),
        lattice(73.0, 3, square=True),
    ],
    ids=lambda true: f"{true.pitch:.1f}-{'square' if true.square else 'hexagonal'}-{true.slant.any()}",
)
def test_centres_of_spots(true: Microlenses) -> None:
    size = (512, 540)
    found = find_microlenses(spots(true, size), name="it")
    assert found.square == true.square
    assert off_centres(found, true, size) < 0.05


def test_a_slanted_lattice_is_counted_from_any_lens() -> None:
    true = lattice(9.0, 2, square=False, slant=(1e-3, -7e-4))
    k, row = np.array([3.0, -12.0, 20.0]), np.array([5.0, 0.0, -9.0])
    moved = true.near(true.centres(k, row)[1])
    np.testing.assert_allclose(moved.origin, true.centres(k, row)[1])
    np.testing.assert_allclose(moved.centres(k + 12, row), true.centres(k, row), atol=1e-9)
    found = moved.places(*(true.centres(k, row)[:1, i].astype(np.float32) for i in (0, 1)))
    np.testing.assert_allclose([float(a[0, 0]) for a in found], [15, 5], atol=1e-3)


def test_a_lattice_that_is_neither_hexagonal_nor_square_is_refused() -> None:
    """Rows at 80 degrees, of which none goes along x."""
    along, down = (10 * np.array([np.cos(a), np.sin(a)]) for a in np.radians((50, 130)))
    with pytest.raises(LightFieldError, match="that is neither hexagonal nor square"):
        Microlenses(np.zeros(2), along, down).reduced(name="it")


def test_what_the_camera_says_of_its_lattice_goes_before_the_spectrum(monkeypatch: pytest.MonkeyPatch) -> None:
    true = lattice(10.0, 0.11, square=False)
    picture = spots(true, (512, 540))
    monkeypatch.setattr("lfgpu.io.lenslet.microlenses.find_peaks", lambda picture: None)
    assert off_centres(find_microlenses(picture, name="it", expected=true), true, picture.shape) < 0.05
    monkeypatch.undo()
    other = lattice(14.3, -3, square=False)  # of another camera
    assert off_centres(find_microlenses(picture, name="it", expected=other), true, picture.shape) < 0.05


def test_thermal_pictures_have_an_offset(tmp_path: Path, sample: Sample) -> None:
    Image.fromarray(eight_bit(sample.raw)).save(tmp_path / "plain.png")
    Image.fromarray(7000 + 4 * eight_bit(sample.raw).astype(np.uint16)).save(tmp_path / "offset.png")
    Image.fromarray((280 + 20 * sample.raw).astype(np.float32)).save(tmp_path / "kelvin.tif")
    plain = read_lenslet(tmp_path / "plain.png")
    for name in ("offset.png", "kelvin.tif"):
        assert recognise(tmp_path / name)[0].name == "lenslet"
        found = read_lenslet(tmp_path / name)
        assert any("are assumed" in note for note in found.notes)
        assert found.views.shape == plain.views.shape
        assert np.abs(found.views.astype(float) - plain.views).mean() / 65535 < 0.03


@pytest.mark.parametrize("camera", CAMERAS, ids=str)
def test_the_grid_is_found(camera: Camera, scene: LightField) -> None:
    sample = capture(scene, camera, noise=0.01)
    white, raw = (find_microlenses(a.astype(np.float32), name="it") for a in (sample.white, sample.raw))
    assert off(white, camera.centres()) < 0.01
    assert off(raw, camera.centres()) < 0.15
    assert white.pitch == pytest.approx(camera.pitch, abs=1e-3)
    assert np.degrees(white.rotation) == pytest.approx(camera.degrees, abs=0.01)
    assert white.row_distance == pytest.approx(camera.row_distance, abs=1e-3)
    assert not is_upright(white)


def grid_of(camera: Camera) -> Microlenses:
    (a, b), pitch = camera.axes, camera.pitch
    return Microlenses(camera.middle, pitch * a, pitch / 2 * a + camera.row_distance * b)


def test_the_nearest_lens_of_each_pixel() -> None:
    camera = Camera(size=(60, 70), degrees=3)
    grid = grid_of(camera)
    k, row = grid.nearest(np.arange(70, dtype=np.float32), np.arange(60, dtype=np.float32))
    found = grid.centres(k, row) - grid.origin
    assert np.abs(np.einsum("ij,yxj->iyx", camera.axes, found) - camera.lens()[0]).max() < 1e-6


def test_harmonics_are_not_taken_for_the_grid(sample: Sample) -> None:
    sharp = (sample.white > 0.3).astype(np.float32)  # hard discs have strong harmonics
    assert find_microlenses(sharp, name="it").pitch == pytest.approx(9.3, abs=0.01)


def test_what_shows_no_microlenses(tmp_path: Path) -> None:
    y, x = np.mgrid[:400, :420]
    rng = np.random.default_rng(0)
    stripes = 0.5 + 0.4 * np.cos(2 * np.pi * (x * 0.1 + y * 0.03))
    view = make("relief", grid=(1, 2), size=(400, 416), channels=1).image(0)[..., 0]
    for name, values in {
        "noise": rng.random((400, 420)),
        "flat": np.full((400, 420), 0.5),
        "black": np.zeros((400, 420)),
        "stripes": stripes,
        "view": view,
        "small": np.full((40, 40), 0.5),
    }.items():
        path = save(tmp_path / f"{name}.png", values)
        assert find_peaks(values.astype(np.float32)) is None
        text = refusal(lambda path=path: read(path, format="lenslet"))
        assert f"{name}.png shows no microlenses" in text
        assert "hexagonal or square lattice" in text
        assert "is not a light field of a known format" in refusal(lambda path=path: read(path))
    Image.fromarray(eight_bit(view)).save(tmp_path / "a.jpg", quality=8)  # in blocks
    assert "is not a light field" in refusal(lambda: read(tmp_path / "a.jpg"))


def test_two_grids_are_not_one(sample: Sample, tmp_path: Path) -> None:
    other = replace(sample.camera, phase=(4.9, 2.2), degrees=1.2)
    both = sample.white.copy()
    both[260:] = other.light(other.lens()[1])[260:]
    assert "not one and the same" in refusal(lambda: decode(save(tmp_path / "both.png", both)))


# --- colours ---


@pytest.mark.parametrize("pattern", PATTERNS)
def test_green_is_found(pattern: str, scene: LightField) -> None:
    sample = capture(scene, Camera(bayer=pattern))
    assert green_diagonal(sample.raw.astype(np.float32)) == (0 if pattern[0] == "g" else 1)


def test_a_grey_sensor_is_recognised(scene: LightField, tmp_path: Path) -> None:
    grey = replace(scene, views=np.repeat(scene.views[..., 1:2], 3, axis=-1))
    sample = capture(grey, Camera(), noise=0.01)
    assert green_diagonal(sample.raw.astype(np.float32)) is None
    light_field = read(save(tmp_path / "grey.png", sample.raw))
    assert light_field.channels == 1
    assert "No mosaic of colours was found: the views are grey." in light_field.notes


def test_demosaicing_keeps_each_microlens_to_itself() -> None:
    camera = Camera(size=(60, 80))
    grid = grid_of(camera)
    centre, offset = camera.lens()
    of_lens = np.random.default_rng(0).random((3, 64, 64)).astype(np.float32)
    k, row = (np.rint(2 * centre[0] / camera.pitch).astype(int), np.rint(centre[1] / camera.row_distance).astype(int))
    truth = of_lens[:, k % 64, row % 64]  # each lens has one colour
    mosaic = np.take_along_axis(truth, camera.colours()[None], 0)[0]
    found = demosaic(mosaic, np.ones_like(mosaic), grid, "bggr")
    well_inside = np.hypot(*offset) < camera.pitch / 2 - 1.5
    well_inside[:3], well_inside[-3:], well_inside[:, :3], well_inside[:, -3:] = False, False, False, False
    assert np.abs(found - truth)[:, well_inside].max() < 0.01


# --- views ---


@pytest.mark.parametrize("camera", [Camera(), Camera(pitch=10.2, degrees=-3, bayer="grbg")], ids=str)
@pytest.mark.parametrize(("with_white", "middle", "corner"), [(True, 0.01, 0.02), (False, 0.015, 0.04)])
def test_views_come_back(
    camera: Camera, with_white: bool, middle: float, corner: float, scene: LightField, tmp_path: Path
) -> None:
    sample = capture(scene, camera)
    raw, white = saved(sample, tmp_path)
    decoded = decode(raw, bayer=camera.bayer, white=white if with_white else None)
    light_field, about = decoded.light_field, decoded.about
    assert light_field.grid_shape == (7, 7)
    assert light_field.views.dtype == np.uint16
    assert light_field.reference == 24
    pixel = about["view_pixel"]
    errors = {}
    for index in (0, 6, 24, 42, 48):
        u, v = light_field.positions[index]
        truth = sample.expected(light_field.size, pixel["first_xy"], pixel["side_px"], u - 3, v - 3)
        errors[index] = np.abs(linear(about, light_field.views[index]) - np.minimum(truth, 1)).mean()
    assert errors.pop(24) < middle
    assert max(errors.values()) < corner


@pytest.mark.parametrize("with_white", [True, False])
def test_disparity_comes_back(with_white: bool, sample: Sample, tmp_path: Path) -> None:
    raw, white = saved(sample, tmp_path)
    decoded = decode(raw, white=white if with_white else None)
    light_field, pixel = decoded.light_field, decoded.about["view_pixel"]
    inner = np.s_[5:-5, 5:-5]
    truth = sample.truth(light_field.size, pixel["first_xy"], pixel["side_px"])[inner]
    assert truth.min() < -0.4
    assert truth.max() > 0.4
    options = {"config": "fast", "disparity_range": (-1, 1), "check_cameras": False}
    for views in ("full", "row", "column"):  # the sign holds across and down
        found = lfgpu.estimate_depth(light_field.subset(views), **options)
        assert np.median(np.abs(found.disparity[inner] - truth)) < 0.02


def test_a_sensor_on_its_side(sample: Sample, tmp_path: Path) -> None:
    level = decode(saved(sample, tmp_path)[0])
    turned = decode(save(tmp_path / "turned.png", sample.raw.T), bayer=transposed(sample.camera.bayer))
    assert "rows upright" in turned.light_field.notes[-1]
    assert turned.about["view_pixel"]["first_xy"] == pytest.approx(level.about["view_pixel"]["first_xy"][::-1])
    for row, column in ((0, 0), (3, 3), (1, 5), (6, 2)):
        view = level.light_field.view(row, column)
        assert np.array_equal(turned.light_field.view(column, row), view.swapaxes(0, 1))


def test_the_number_of_views(sample: Sample, tmp_path: Path) -> None:
    raw, _ = saved(sample, tmp_path)
    five = decode(raw, views=5).light_field
    assert five.grid_shape == (5, 5)
    assert np.array_equal(five.view(2, 2), decode(raw).light_field.view(3, 3))
    nine = decode(raw, views=9).light_field  # the corners lie beyond the microlens, 4.65 px from its centre
    assert len(nine.missing) == 12
    assert {(0, 0), (0, 1), (1, 0)} <= set(nine.missing)
    assert any("12 of 81 views lie beyond the microlenses" in note for note in nine.notes)
    assert decode(raw, views=4).light_field.reference_index == 10
    for views in (1, 32, -3):
        assert "the number of views must be 2 to 31" in refusal(lambda views=views: decode(raw, views=views))


def test_dark_parts_of_a_white_image_are_not_valid(sample: Sample, tmp_path: Path) -> None:
    raw, white = saved(sample, tmp_path)
    assert decode(raw, white=white).light_field.valid is None
    shaded = sample.white.copy()
    shaded[:200, :200] *= 0.1
    valid = decode(raw, white=save(tmp_path / "shaded.png", shaded)).light_field.valid
    assert not valid[:, :18, :18].any()
    assert valid[24, 30:, 30:].all()


def test_views_are_evened_out_over_their_fields() -> None:
    views = make("planes", grid=(1, 3), size=(150, 160), disparity_range=(-0.8, 0.8), dtype=np.float32).views
    y, x = np.mgrid[-1:1:150j, -1:1:160j]
    falloff = np.stack([1 - 0.4 * (x + y > 0) * (x + y) ** 2 / 2, np.ones_like(x), 0.8 - 0.15 * x])
    gains = field_gains((views * falloff[..., None]).astype(np.float32), 1)
    assert np.array_equal(gains[1], np.ones_like(gains[1]))
    assert np.median(np.abs(gains * falloff - 1)) < 0.02
    assert np.abs(gains * falloff - 1)[:, 15:-15, 15:-15].max() < 0.1
    assert np.abs(falloff - 1).max() > 0.3


def test_what_cannot_be_a_white_image(sample: Sample, tmp_path: Path) -> None:
    raw, white = saved(sample, tmp_path)
    small = save(tmp_path / "small.png", sample.white[:-2])
    text = refusal(lambda: decode(raw, white=small))
    assert "small.png is no white image for this capture: it is 560 x 518 pixels, the capture 560 x 520" in text
    flat = save(tmp_path / "flat.png", np.full_like(sample.white, 0.9))
    assert "flat.png shows no microlenses" in refusal(lambda: decode(raw, white=flat))
    assert "nowhere.png" in refusal(lambda: decode(raw, white=tmp_path / "nowhere.png"))
    assert "the Bayer pattern must be one of bggr" in refusal(lambda: decode(raw, white=white, bayer="rgb"))


def test_pictures_of_other_kinds(sample: Sample, tmp_path: Path) -> None:
    values = np.rint(sample.raw * 65535).astype(np.uint16)
    Image.fromarray(values).save(tmp_path / "deep.tif")
    Image.fromarray(values).save(tmp_path / "deep.png")
    Image.fromarray(eight_bit(sample.raw)).save(tmp_path / "raw.jpg", quality=95)
    deep = read(tmp_path / "deep.tif").views
    assert np.array_equal(deep, read(tmp_path / "deep.png").views)
    from_jpeg = read(tmp_path / "raw.jpg").views
    assert np.abs(deep[24].astype(float) - from_jpeg[24]).mean() < 0.02 * 65535
    Image.fromarray(np.repeat(eight_bit(sample.raw)[..., None], 3, axis=-1)).save(tmp_path / "colour.png")
    assert "a raw capture is grey" in refusal(lambda: read(tmp_path / "colour.png", format="lenslet"))
    whole = (tmp_path / "raw.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) // 3])
    assert "cut.jpg" in refusal(lambda: read(tmp_path / "cut.jpg", format="lenslet"))


# --- as a format, and on the command line ---


def test_decoded_views_are_read_again(sample: Sample, tmp_path: Path) -> None:
    raw, white = saved(sample, tmp_path)
    decoded = decode(raw, white=white)
    files = write_decoded(decoded, tmp_path / "out")
    assert sorted(files) == sorted(path.name for path in (tmp_path / "out").iterdir())
    again = read(tmp_path / "out")
    assert np.array_equal(again.views, decoded.light_field.views)
    assert np.array_equal(again.positions, decoded.light_field.positions)
    assert json.loads((tmp_path / "out" / "lenslet.json").read_text()) == decoded.about
    text = refusal(lambda: write_decoded(decode(raw, views=5), tmp_path / "out"))
    assert "holds view_00_05.png of another light field or film; choose" in text
    write_decoded(decoded, tmp_path / "out")

"""Raw captures and containers on the command line, in the cache of the user, and two of a first-generation Lytro."""

import zipfile
from pathlib import Path

import lytro_samples
import numpy as np
import pytest
from command_line import lfgpu, refused
from conftest import real_data
from fields import SAMPLES, scene
from lenslet_samples import Camera, capture, eight_bit
from PIL import Image
from scipy import ndimage
from scipy.io import loadmat

from lfgpu.batch.items import find_items
from lfgpu.data import LightField
from lfgpu.io import read, read_map
from lfgpu.io.images import read_image
from lfgpu.io.lenslet import entry as module
from lfgpu.io.lenslet.capture import read_capture
from lfgpu.io.lenslet.decode import decode
from lfgpu.io.lenslet.entry import folder, kept
from lfgpu.io.lenslet.microlenses import find_microlenses
from lfgpu.scenes import make
from tests.made import thorough


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raw capture and its white image beside it."""
    folder = tmp_path_factory.mktemp("capture")
    sample = capture(make("planes", grid=(9, 9), size=(50, 54), disparity_range=(-0.6, 0.6)), Camera(size=(360, 390)))
    Image.fromarray(eight_bit(sample.white)).save(folder / "white.png")
    Image.fromarray(eight_bit(sample.raw)).save(folder / "raw.png")
    return folder / "raw.png"


def said(*arguments: object) -> str:
    """What a command says that ends well, in one line."""
    done = lfgpu(*arguments)
    assert done.code == 0, done.err
    return " ".join(done.out.split())


def test_decode_writes_what_is_read_again(raw: Path, tmp_path: Path) -> None:
    told = said("decode", raw, "-o", tmp_path / "views", "--white", raw.with_name("white.png"), "--views", 5)
    for words in ("25 of 25 in a 5 x 5 grid", "grey picture, uint8", "bggr", "grid and vignetting from white.png"):
        assert words in told
    assert len(list((tmp_path / "views").iterdir())) == 26
    assert read(tmp_path / "views").views.dtype == np.uint16


def test_depth_and_info_take_the_raw_file(raw: Path, tmp_path: Path) -> None:
    words = "lenslet, because it is a grey picture of microlenses, a hexagonal lattice 9."
    assert words in said("info", raw)
    said("depth", raw, "-o", tmp_path / "out", "--preset", "fast", "--disparity-range=-1,1")
    assert read_map(tmp_path / "out" / "disparity.pfm").shape == read(raw).size


def test_what_is_refused_leaves_nothing(raw: Path, tmp_path: Path) -> None:
    refused(lfgpu("decode", raw, "-o", tmp_path / "views", "--white", "nowhere.png"), "nowhere.png does not exist")
    assert not (tmp_path / "views").exists()


made: list[str] = []


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "folder", folder)  # as it is for users
    made.clear()
    return tmp_path / "cache"


def make_views() -> LightField:
    made.append("")
    views = np.random.default_rng(1).integers(0, 65535, (4, 6, 7, 3), dtype=np.uint16)
    valid = np.random.default_rng(2).random((4, 6, 7)) > 0.2
    places = [[0, 0], [1, 0], [0, 1], [1, 1]]
    return LightField(views, places, reference=3, grid_shape=(2, 2), valid=valid, name="raw", notes=("Green is at 0.",))


def test_it_is_made_once_and_the_same_when_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "raw.lfr").write_bytes(b"one")
    first, second = (kept(tmp_path / "raw.lfr", make_views) for _ in range(2))
    assert len(made) == 1
    for name in ("views", "positions", "valid"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    assert (second.reference_index, second.grid_shape, second.name, second.notes) == (3, (2, 2), "raw", first.notes)
    (tmp_path / "raw.lfr").write_bytes(b"two")
    kept(tmp_path / "raw.lfr", make_views)
    assert len(made) == 2


def test_what_cannot_be_kept_or_read_is_made(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "raw.lfr").write_bytes(b"one")
    kept(tmp_path / "raw.lfr", make_views)
    (file,) = folder().glob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    kept(tmp_path / "raw.lfr", make_views)
    kept(tmp_path / "raw.lfr", make_views)
    assert len(made) == 2
    cache.rename(tmp_path / "gone")
    cache.write_text("no folder")
    assert kept(tmp_path / "raw.lfr", make_views).name == "raw"


def test_there_is_an_end_of_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_ROOM", 3000)
    for number in range(4):
        (tmp_path / "raw.lfr").write_bytes(bytes([number]))
        kept(tmp_path / "raw.lfr", make_views)
    assert 1 <= len(list(folder().glob("*.npz"))) < 4


CAPTURES = [
    pytest.param("tao2013_IMG_1", marks=pytest.mark.data("tao2013_IMG_1")),
    pytest.param("tao2013_IMG_4", marks=[pytest.mark.data("tao2013_IMG_4"), pytest.mark.thorough]),
]


def real_raw(real_folder: Path) -> Path:
    return real_folder / f"{real_folder.name.removeprefix('tao2013_')}.jpg"


def their_centres() -> np.ndarray:
    """(x, y) of lenses [362, 311, 2], in our counting: theirs is (y, x), whole numbers, the first pixel being 1."""
    return loadmat(real_data("tao2013_image_cords.mat"))["image_cords"].astype(np.float64)[..., ::-1] - 1


@pytest.fixture(params=CAPTURES)
def real_folder(data_folder: Path) -> Path:
    return data_folder


def test_the_grid_is_theirs(real_folder: Path) -> None:
    grid = find_microlenses(read_capture(real_raw(real_folder)).mosaic, name="it")
    steps = np.stack([grid.along, grid.down], axis=1)
    from_origin = their_centres() - grid.origin
    number = np.rint(from_origin @ np.linalg.inv(steps).T)
    off = from_origin - number @ steps.T
    assert np.sqrt((off**2).sum(-1).mean()) < 0.55  # 0.41 of it comes from their whole numbers
    assert np.abs(off.mean((0, 1))).max() < 0.2


@pytest.mark.thorough
@pytest.mark.data("tao2013_IMG_1")
def test_the_views_are_theirs(data_folder: Path) -> None:
    """The same view at the same place, in linear values up to a factor; the views beside it are less alike."""
    real_folder, decoded = data_folder, decode(real_raw(data_folder))
    views, about = decoded.light_field, decoded.about
    assert views.grid_shape == (7, 7)
    along = np.array(about["microlenses"]["along_xy"])
    along /= np.hypot(*along)
    axes = np.array([along, [-along[1], along[0]]])
    pixel = about["view_pixel"]
    x, y = np.moveaxis((their_centres() - pixel["first_xy"]) @ axes.T / pixel["side_px"], -1, 0)
    height, width = views.size
    inside = (x > 1) & (x < width - 2) & (y > 1) & (y < height - 2)
    assert inside.mean() > 0.95

    def green(row: int, column: int) -> np.ndarray:
        linear = about["values"]["white_level"] * (views.view(row, column)[..., 1] / 65535) ** 2
        return ndimage.map_coordinates(linear, [y, x], order=1)[inside]

    def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
        used = (theirs < 0.97) & (ours < 0.97)  # not cut off
        ours, theirs = ours[used], theirs[used]
        return float(np.abs(ours * (ours @ theirs) / (ours @ ours) - theirs).mean())

    for row, column in ((3, 3), (3, 1), (1, 3), (5, 5)):
        image, _ = read_image(real_folder / f"view_{row:02d}_{column:02d}.png")
        theirs = image[..., 1][inside] / 255
        at_place = difference(green(row, column), theirs)
        assert at_place < 0.02
        for other in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            assert difference(green(*other), theirs) > 1.1 * at_place


@pytest.mark.data("real/synth_spots")
@pytest.mark.parametrize(
    ("name", "square", "limit"),
    [
        # The first picture is not drawn where its list says. A Gaussian fitted to each spot lies 0.2 to 0.5 px beside
        # the list in x and y, and 1.4 px in the first row and column; in the second picture it lies on the list
        # (0.00 px on average). So it is not where pixels have their centres, which would move all four pictures.
        thorough("a", True, 0.55),
        thorough("b", False, 0.03),
        ("c", False, 0.02),
        ("d", True, 0.01),
    ],
)
def test_the_centres_of_synthetic_spots(data_folder: Path, name: str, square: bool, limit: float) -> None:
    with zipfile.ZipFile(data_folder / "synth_spots.zip") as archive:
        with archive.open(f"{name}.png") as file, Image.open(file) as image:
            picture = np.asarray(image).astype(np.float32)
        with archive.open(f"{name}.txt") as file:
            true = np.loadtxt(file)[:, ::-1]
    true = true[((true > 0) & (true < 719)).all(axis=1)]
    found = find_microlenses(picture, name=name)
    assert found.square == square
    off = np.array([found.near(centre).origin - centre for centre in true])
    assert np.sqrt((off**2).sum(axis=1).mean()) < limit
    assert np.sqrt(((off - off.mean(axis=0)) ** 2).sum(axis=1).mean()) < 0.1


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    content, data = lytro_samples.focal_stack(scene((1, 3), (36, 34)).views)
    path = tmp_path / "IMG_0007-stk.lfp"
    path.write_bytes(lytro_samples.processed([("refocusStack", content)], data, camera=lytro_samples.CAMERA))
    return path


def test_info_says_what_a_focal_stack_is(stack: Path) -> None:
    told = said("info", stack)
    assert "IMG_0007-stk format lytro, because it is a container of Lytro's program" in told
    assert "contents a focal stack" in told
    assert "camera Lytro, Inc. F01" in told
    assert "no depth it holds a focal stack" in told
    refused(lfgpu("depth", stack, "-o", stack.parent / "out"), "all show the scene from one place")


def test_decode_is_for_raw_captures(stack: Path, tmp_path: Path) -> None:
    words = "has no raw picture: it is a Lytro container with a focal stack"
    refused(lfgpu("decode", stack, "-o", tmp_path / "out"), words)
    file = SAMPLES["lytro-pictures"].write(scene((3, 3), (36, 34)), tmp_path)
    assert "contents 9 views of 34 x 36 px, a focal stack" in said("info", file)


def test_batches_take_each_container_that_has_views(stack: Path, tmp_path: Path) -> None:
    SAMPLES["lytro-pictures"].write(scene((3, 3), (36, 34)), tmp_path)
    (tmp_path / "damaged.lfp").write_bytes(stack.read_bytes()[:3000])
    items, barren = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["IMG_0002-stk.lfp", "damaged.lfp"]
    assert barren == []


def test_depth_of_cameras_of_which_no_two_are_in_line(tmp_path: Path) -> None:
    lf = scene((3, 3), (36, 34))
    places = np.array([[0, 0], [0.5, 1], [1, 0.5]])
    np.savez(tmp_path / "a.npz", views=lf.views[:3], positions=places)
    said("depth", tmp_path / "a.npz", "-o", tmp_path / "out", "--preset=fast")
    assert (tmp_path / "out" / "disparity.pfm").is_file()

"""Two captures of a first-generation Lytro (Tao et al. 2013), with the lens centres and views that others found."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from scipy.io import loadmat

from lfgpu.io import recognise
from lfgpu.io.images import read_image
from lfgpu.io.lenslet.capture import read_capture
from lfgpu.io.lenslet.decode import decode
from lfgpu.io.lenslet.microlenses import find_microlenses

CAPTURES = [pytest.param(name, marks=pytest.mark.data(name)) for name in ("tao2013_IMG_1", "tao2013_IMG_4")]
CORDS = "tao2013_image_cords.mat"


def raw(folder: Path) -> Path:
    return folder / f"{folder.name.removeprefix('tao2013_')}.jpg"


def their_centres(folder: Path) -> np.ndarray:
    """(x, y) of lenses [362, 311, 2], in our counting: theirs is (y, x), whole numbers, the first pixel being 1."""
    cords = folder.parent / CORDS
    if not cords.is_file():
        pytest.skip(f"{cords} is not there")
    return loadmat(cords)["image_cords"].astype(np.float64)[..., ::-1] - 1


@pytest.fixture(params=CAPTURES)
def folder(data_folder: Path) -> Path:
    return data_folder


def test_the_raw_file_is_recognised(folder: Path) -> None:
    entry, reason = recognise(raw(folder))
    assert entry.name == "lenslet"
    assert "microlenses" in reason


def test_the_grid_is_theirs(folder: Path) -> None:
    grid = find_microlenses(read_capture(raw(folder)).mosaic, name="it")
    steps = np.stack([grid.along, grid.down], axis=1)
    from_origin = their_centres(folder) - grid.origin
    number = np.rint(from_origin @ np.linalg.inv(steps).T)
    off = from_origin - number @ steps.T
    assert np.sqrt((off**2).sum(-1).mean()) < 0.55  # 0.41 of it comes from their whole numbers
    assert np.abs(off.mean((0, 1))).max() < 0.2


@pytest.mark.data("tao2013_IMG_1")
def test_the_views_are_theirs(data_folder: Path) -> None:
    """The same view at the same place, in linear values up to a factor; the views beside it are less alike."""
    folder, decoded = data_folder, decode(raw(data_folder))
    views, about = decoded.light_field, decoded.about
    assert views.grid_shape == (7, 7)
    along = np.array(about["microlenses"]["along_xy"])
    along /= np.hypot(*along)
    axes = np.array([along, [-along[1], along[0]]])
    pixel = about["view_pixel"]
    x, y = np.moveaxis((their_centres(folder) - pixel["first_xy"]) @ axes.T / pixel["side_px"], -1, 0)
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
        image, _ = read_image(folder / f"view_{row:02d}_{column:02d}.png")
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
        ("a", True, 0.55),
        ("b", False, 0.03),
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

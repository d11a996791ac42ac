"""Renders of Blender's light field add-on: cameras, lenses, depth, and what is refused."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import BLENDER_FOCAL, BLENDER_STEP, SAMPLES, blender_depth, write_exr
from PIL import Image
from samples import changed, refusal

from lfgpu.data import LightField
from lfgpu.io import read, recognise
from lfgpu.io.parallax import axes_agree, runs_as_truth
from lfgpu.scenes import make

pytest.importorskip("OpenEXR")


@pytest.fixture(scope="module")
def true() -> LightField:
    """Everything is before infinity, as it is for cameras whose frames are not shifted."""
    return make("boxes", grid=(3, 5), size=(40, 48), disparity_range=(0.3, 2.5))


@pytest.fixture(scope="module")
def rendered(true: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return SAMPLES["blender"].write(true, tmp_path_factory.mktemp("blender"))


@pytest.fixture
def folder(rendered: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(rendered, tmp_path / "LFPlane"))


def change(folder: Path, **values: Any) -> None:
    """Other values in the configuration, see `changed`."""
    file = folder / "lightfield.json"
    file.write_text(json.dumps(changed(json.loads(file.read_text()), **values)))


def frames(folder: Path) -> list[dict[str, Any]]:
    return list(json.loads((folder / "lightfield.json").read_text())["frames"])


def test_depth_is_the_truth(rendered: Path, true: LightField) -> None:
    found = read(rendered)
    assert (found.grid_shape, found.views.dtype, found.name) == ((3, 5), np.uint16, "LFPlane")
    truth, geometry = found.reference_truth(), found.geometry
    np.testing.assert_allclose(truth.disparity, true.truth.disparity, atol=1e-4)
    np.testing.assert_allclose(geometry.depth(truth.disparity), blender_depth(true), rtol=1e-5)
    assert geometry.focal_length_px == pytest.approx(BLENDER_FOCAL)
    assert geometry.baseline_m == pytest.approx(BLENDER_STEP)
    assert geometry.principal_point == pytest.approx((23.5, 19.5))
    assert runs_as_truth(found, 0) is True
    assert axes_agree(found) is not False
    np.testing.assert_allclose(found.views / 65535, true.views / 255, atol=2e-4)
    again = read(rendered / "lightfield.json")
    np.testing.assert_array_equal(again.views, found.views)


def test_angles_say_what_a_matrix_does(folder: Path) -> None:
    first = read(folder)
    listed = frames(folder)
    for frame in listed:
        del frame["world_matrix"]
        frame["rotation"] = [np.pi / 2, 0.0, -np.pi / 2]
    change(folder, frames=listed)
    found = read(folder)
    np.testing.assert_array_equal(found.positions, first.positions)
    assert found.grid_shape == first.grid_shape


@pytest.mark.parametrize(
    "camera",
    [
        {"type": "PERSP", "lens_unit": "MILLIMETERS", "focal_length": BLENDER_FOCAL * 36 / 48},
        {"type": "PERSP", "lens_unit": "FOV", "angle": 2 * np.arctan(24 / BLENDER_FOCAL)},
    ],
)
def test_the_focal_length_without_a_matrix(camera: dict[str, Any], folder: Path) -> None:
    change(folder, camera=camera)
    geometry = read(folder).geometry
    assert geometry.focal_length_px == pytest.approx(BLENDER_FOCAL)


def test_a_shifted_lens_and_tall_pixels(folder: Path) -> None:
    matrix = json.loads((folder / "lightfield.json").read_text())["camera"]["projection_matrix"]
    matrix[0][2], matrix[1][2], matrix[1][1] = 0.25, -0.5, matrix[1][1] * 0.5
    change(folder, camera__projection_matrix=matrix)
    found = read(folder)
    assert found.geometry.principal_point == pytest.approx((0.75 * 24 - 0.5, 0.5 * 20 - 0.5))
    assert found.geometry.pixel_aspect == pytest.approx(0.5)
    assert found.grid_shape is None  # a row of cameras moves things by half as many pixels as a column does
    np.testing.assert_allclose(np.unique(found.positions[:, 1]), [0, 0.5, 1])


def test_layers_depth_without_an_end_and_half_floats(folder: Path, true: LightField) -> None:
    import OpenEXR

    for file in (folder / "exr").glob("*.exr"):
        with OpenEXR.File(str(file), separate_channels=True) as image:
            stored = {name: np.array(channel.pixels) for name, channel in image.channels().items()}
        depth = stored["Z"].copy()
        depth[:3], depth[3] = 1e10, -1
        channels = {f"ViewLayer.Combined.{c}": stored[c].astype(np.float16) for c in "RGB"}
        channels |= {"ViewLayer.Depth.Z": depth, "ViewLayer.Normal.Z": np.ones_like(depth)}
        write_exr(file, channels)
    found = read(folder)
    truth = found.reference_truth()
    assert (truth.disparity[:3] == 0).all()
    assert np.isnan(truth.disparity[3]).all()
    np.testing.assert_allclose(truth.disparity[4:], true.truth.disparity[4:], atol=1e-4)
    np.testing.assert_allclose(found.views / 65535, true.views / 255, atol=2e-3)


def test_images_without_depth(folder: Path, true: LightField) -> None:
    (folder / "png").mkdir()
    for frame, view in zip(frames(folder), true.views, strict=True):
        Image.fromarray(view).save(folder / "png" / f"{frame['name']}.png")
    shutil.rmtree(folder / "exr")
    found = read(folder)
    assert recognise(folder)[0].name == "blender"
    np.testing.assert_array_equal(found.views, true.views)
    assert found.truth is None
    assert found.geometry is not None


def test_what_is_refused(folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    listed = frames(folder)
    turned = json.loads(json.dumps(listed))
    turned[3]["world_matrix"] = np.eye(4).tolist()
    before = json.loads(json.dumps(listed))
    before[3]["world_matrix"][0][3] += 0.01

    def says(words: str, **values: Any) -> None:
        copy = Path(shutil.copytree(folder, tmp_path / "copy", dirs_exist_ok=True))
        change(copy, **values)
        assert words in refusal(lambda: read(copy, format="blender"))
        shutil.rmtree(copy)

    says("cameras that look in several directions", frames=turned)
    says("stand up to 0.01 m before others", frames=before)
    says("several cameras in one place", frames=[listed[0], *listed])
    says("has 1 cameras", frames=listed[:1])
    says("'a/../b' is no name of an image", frames=[{**listed[0], "name": "a/../b"}, *listed[1:]])
    says("is no name of an image", frames=[{**listed[0], "name": 400 * "x"}, *listed[1:]])
    says("lacks the images of 1 of 15 cameras, such as x", frames=[*listed[:-1], {**listed[-1], "name": "x"}])
    says("of the type 'PANO'", camera__type="PANO")
    says("says 50 x 40 px, but the images are 48 x 40", resolution=[50, 40])
    says("world_matrix must be 4 x 4 numbers", frames=[{**listed[0], "world_matrix": [1, 2]}, *listed[1:]])
    skew = np.ones((4, 4)).tolist()
    says("axes of the camera 'view_0000f' are no axes", frames=[{**listed[0], "world_matrix": skew}, *listed[1:]])
    says("nothing for camera", camera=None)
    says("a JSON str for frames", frames="none")
    data = bytearray((folder / "exr" / "view_0002f.exr").read_bytes())
    data[-200:] = bytes(200)
    (folder / "exr" / "view_0002f.exr").write_bytes(data)
    assert "view_0002f.exr cannot be read as OpenEXR: its pixels are damaged" in refusal(lambda: read(folder))
    assert capfd.readouterr() == ("", "")
    (folder / "exr" / "view_0002f.exr").write_bytes(b"no image")
    assert "view_0002f.exr is not an OpenEXR file" in refusal(lambda: read(folder))
    (folder / "exr" / "view_0002f.exr").unlink()
    found = read(folder, allow_missing=True)
    assert (len(found.views), found.missing) == (14, ((0, 2),))
    assert "whose images are not there" in found.notes[0]
    (folder / "lightfield.json").write_text("{")
    assert "is not valid JSON" in refusal(lambda: read(folder, format="blender"))

"""Quilts and colour with depth: for displays that show several views."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from PIL import Image
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.io import save, write_hci
from lfgpu.methods import method_of
from lfgpu.viz.rendering import Renderer


@pytest.fixture(scope="module")
def planes() -> LightField:
    return scenes.make("planes", grid=(3, 5), size=(40, 52), seed=1)


def render(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["render", *map(str, arguments), "--device=cpu"])


def test_a_quilt_goes_from_left_to_right_and_from_the_bottom_up(planes: LightField, tmp_path: Path) -> None:
    write_hci(planes, tmp_path / "lf")
    config = method_of("fast").for_rendering
    maps = lfgpu.estimate_all_views(planes, config=config, disparity_range=(-2, 2), device="cpu")
    save(maps, tmp_path / "maps.npz")
    outcome = render(tmp_path / "lf", "--quilt=3x2", "--maps", tmp_path / "maps.npz", "-o", tmp_path / "q.png")
    assert outcome.exit_code == 0, outcome.output
    file = tmp_path / "q_qs3x2a1.3.png"
    assert file.name in outcome.output
    image = np.asarray(Image.open(file)).astype(float) / 255
    assert image.shape == (80, 156, 3)
    renderer = Renderer(planes, maps, device="cpu")
    for n, u in enumerate((0, 0.8, 1.6, 2.4, 3.2, 4)):
        row, column = 1 - n // 3, n % 3
        tile = image[40 * row : 40 * row + 40, 52 * column : 52 * column + 52]
        np.testing.assert_allclose(tile, renderer(1.0, u).image, rtol=0, atol=0.003)


def test_colour_and_depth_side_by_side(planes: LightField, tmp_path: Path) -> None:
    write_hci(planes, tmp_path / "lf")
    result = lfgpu.estimate_depth(planes, config="fast", disparity_range=(-2, 2), device="cpu")
    save(result, tmp_path / "map.pfm")
    outcome = render(tmp_path / "lf", "--rgbd", "--maps", tmp_path / "map.pfm", "-o", tmp_path / "rgbd.png")
    assert outcome.exit_code == 0, outcome.output
    image = np.asarray(Image.open(tmp_path / "rgbd.png")).astype(float)
    np.testing.assert_array_equal(image[:, :52], planes.views[planes.reference_index])
    depth = image[:, 52:, 0]
    assert depth.max() == 255
    assert np.corrcoef(depth.ravel(), result.disparity.ravel())[0, 1] > 0.99  # white is near


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--quilt=0x4"], "--quilt must be of 2 to 200 views"),
        (["--quilt=many"], "--quilt must be COLUMNSxROWS"),
        (["--quilt=2x2", "--rgbd"], "give one of"),
    ],
)
def test_wrong_layouts_are_one_sentence(arguments: list[str], words: str, tmp_path: Path) -> None:
    outcome = render(tmp_path, *arguments, "-o", tmp_path / "out.png")
    assert outcome.exit_code == 1
    assert words in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1


def test_a_column_of_cameras_makes_no_quilt(planes: LightField, tmp_path: Path) -> None:
    write_hci(planes.subset("column"), tmp_path / "lf")
    outcome = render(tmp_path / "lf", "--quilt=2x2", "-o", tmp_path / "out.png")
    assert outcome.exit_code == 1
    assert "beside each other" in outcome.stderr

"""`lfgpu info` and `lfgpu decode` on containers, patterns that are meant, and outputs that people look at."""

from pathlib import Path

import lytro_samples
import numpy as np
import pytest
from fields import SAMPLES, scene
from samples import box, refusal, save_named, star
from typer.testing import CliRunner

from lfgpu.batch.items import find_items
from lfgpu.cli import app
from lfgpu.data.geometry import Geometry
from lfgpu.data.result import DisparityMap
from lfgpu.io import load, read, save
from lfgpu.io.ply import read_ply


def lfgpu(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.stderr
    return " ".join((done.stdout if code == 0 else done.stderr).split())


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    content, data = lytro_samples.focal_stack(scene((1, 3), (36, 34)).views)
    path = tmp_path / "IMG_0007-stk.lfp"
    path.write_bytes(lytro_samples.processed([("refocusStack", content)], data, camera=lytro_samples.CAMERA))
    return path


def test_info_says_what_a_focal_stack_is(stack: Path) -> None:
    said = lfgpu("info", stack)
    assert "IMG_0007-stk format lytro, because it is a container of Lytro's program" in said
    assert "focal stack 3 pictures focused at λ -1 to 1" in said
    assert "camera Lytro, Inc. F01" in said
    assert "no depth it holds a focal stack" in said
    assert "all show the scene from one place" in lfgpu("depth", stack, "-o", stack.parent / "out", code=1)


def test_decode_writes_what_a_container_holds(stack: Path, tmp_path: Path) -> None:
    said = lfgpu("decode", stack, "-o", tmp_path / "out")
    assert "focus_00.jpg ... 3 pictures" in said
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        *(f"focus_0{i}.jpg" for i in range(3)),
        "lambda.pfm",
        "lytro.json",
    ]
    assert "leave --white, --bayer and --views out" in lfgpu(
        "decode", stack, "-o", tmp_path / "x", "--views", 3, code=1
    )


def test_views_of_a_container_are_decoded_and_read_again(tmp_path: Path) -> None:
    lf = scene((3, 3), (36, 34))
    file = SAMPLES["lytro-pictures"].write(lf, tmp_path)
    said = lfgpu("info", file)
    assert "contents 9 views of 34 x 36 px, a focal stack of 2 pictures" in said
    lfgpu("decode", file, "-o", tmp_path / "out")
    np.testing.assert_array_equal(read(tmp_path / "out").views, read(file).views)


def test_batches_take_each_container_that_has_views(stack: Path, tmp_path: Path) -> None:
    SAMPLES["lytro-pictures"].write(scene((3, 3), (36, 34)), tmp_path)
    (tmp_path / "damaged.lfp").write_bytes(stack.read_bytes()[:3000])
    items, barren = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["IMG_0002-stk.lfp", "damaged.lfp"]
    assert barren == []


def test_patterns_that_are_meant_are_not_missing(tmp_path: Path) -> None:
    said = lfgpu("info", save_named(tmp_path / "star", star(5)))
    assert "17 of 25 in a 5 x 5 grid (rows x columns), a star" in said
    assert "missing" not in said
    corners = lfgpu("info", save_named(tmp_path / "corners", [(0, 0), (0, 8), (8, 0), (8, 8)]))
    assert "missing 77" not in corners
    assert "4 of 81 views of the 9 x 9 grid are there" in corners
    assert "missing 1: row 2, column 2" in lfgpu("info", save_named(tmp_path / "lost", box(3, 3)[:-1]))


def test_maps_of_one_view_are_refused_for_new_views_by_the_name_of_the_option(tmp_path: Path) -> None:
    folder = save_named(tmp_path / "lf", box(3, 3))
    (tmp_path / "maps").mkdir()
    said = lfgpu("render", folder, "--view=0,1", "--maps", tmp_path / "maps", "-o", tmp_path / "a.png", code=1)
    assert "run lfgpu depth --all-views, or leave --maps out" in said


def test_depth_of_cameras_of_which_no_two_are_in_line(tmp_path: Path) -> None:
    lf = scene((3, 3), (36, 34))
    places = np.array([[0, 0], [0.5, 1], [1, 0.5]])
    np.savez(tmp_path / "a.npz", views=lf.views[:3], positions=places)
    lfgpu("depth", tmp_path / "a.npz", "-o", tmp_path / "out", "--preset=fast")
    assert (tmp_path / "out" / "disparity.pfm").is_file()


GEOMETRY = Geometry(focal_length_px=100.0, baseline_m=0.1)
SLOPE = np.linspace(-1, 1, 40 * 60, dtype=np.float32).reshape(40, 60)


@pytest.mark.parametrize("geometry", [None, GEOMETRY])
def test_exr_names_only_channels_that_it_has(geometry: Geometry | None, tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    save(DisparityMap(SLOPE + 2, geometry=geometry), tmp_path / "a.exr")
    with exr.File(str(tmp_path / "a.exr")) as file:
        assert ("Z" in file.channels()) == (geometry is not None)
        assert ('"Z"' in str(file.header()["lfgpu"])) == (geometry is not None)


def test_a_cloud_without_geometry_is_no_flat_sheet(tmp_path: Path) -> None:
    save(DisparityMap(SLOPE), tmp_path / "a.ply")
    points, comments = read_ply(tmp_path / "a.ply")
    z = points["z"]
    assert 0.2 * 60 < np.ptp(z) < 0.6 * 60
    np.testing.assert_allclose(z, -8 * points["disparity"])
    assert "z is -8 times the disparity" in comments[0]


def test_a_map_whose_pixels_are_damaged_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("OpenEXR")
    file = tmp_path / "a.exr"
    save(DisparityMap(SLOPE), file)
    data = bytearray(file.read_bytes())
    data[-200:] = bytes(200)
    file.write_bytes(data)
    assert "its pixels are damaged" in refusal(lambda: load(file))
    assert capfd.readouterr() == ("", "")

"""`lfgpu depth --save`, `convert`, `render`, and `eval` of what they wrote."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import RANGE, lfgpu, refused, said
from PIL import Image

from lfgpu import PRESETS, evaluate, load, point_cloud, read, refocus, render_view, scenes
from lfgpu.calibration import export_scene
from lfgpu.errors import LightFieldError
from lfgpu.io import write_description, write_hci
from lfgpu.io.images import read_view
from tests.made import thorough

SAVED = ("map.exr", "map.tif", "map16.png", "cloud.ply", "map.npz", "map.pfm")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "boxes"
    write_hci(scenes.make("boxes", grid=(3, 3), size=(48, 56), seed=1), folder)
    return folder


@pytest.fixture(scope="module")
def solved(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("solved") / "out"
    saves = [word for name in SAVED for word in ("--save", name)]
    text = said("depth", recorded, "-o", out, "--all-views", "--preset", "fast", *RANGE, *saves)
    assert all(name in text for name in SAVED)
    return out


def scores(text: str) -> list[str]:
    """The last row of the table of scores, without its name."""
    rows = [line.split() for line in text.splitlines() if line.count(" %") == 4]
    return rows[-1][1:]


def test_every_saved_map_scores_as_the_result_does(recorded: Path, solved: Path) -> None:
    names = [name for name in SAVED if not name.endswith(".ply")]
    true, *found = (scores(said("eval", path, recorded)) for path in (solved, *(solved / name for name in names)))
    for name, one in zip(names, found, strict=True):
        if name == "map16.png":
            np.testing.assert_allclose(float(one[0]), float(true[0]), rtol=0.01)
        else:
            assert one == true, name


def test_maps_of_all_views_are_scored(recorded: Path, solved: Path) -> None:
    lf, maps = read(recorded), load(solved / "disparities.npz")
    metrics = evaluate(maps.disparities[lf.reference_index], lf.truth.disparity)
    found = scores(said("eval", solved / "disparities.npz", recorded))
    assert float(found[0]) == pytest.approx(metrics.mse_100, abs=1e-3)
    assert scores(said("eval", solved / "disparities.npz", recorded / "gt_disp_lowres.pfm")) == found


def test_outputs_of_an_earlier_run_go_and_other_files_stay(recorded: Path, loose: Path, tmp_path: Path) -> None:
    out, last = tmp_path / "out", tmp_path / "last"
    fast = ("--preset", "fast", *RANGE, "-q")
    said("depth", recorded, "-o", out, "--all-views", "--report", "--save", "mine.tif", *fast)
    names = {path.name for path in out.iterdir()}
    assert {"depth.pfm", "disparities.npz", "report.html"} < names
    refused(lfgpu("depth", loose, *READ, "-o", out, "--reference-view", "9,9", *fast), "no view")
    assert {path.name for path in out.iterdir()} == names
    for folder in (out, last):
        said("depth", loose, *READ, "-o", folder, *fast)
    assert {path.name for path in out.iterdir()} == {*(path.name for path in last.iterdir()), "mine.tif"}


def test_outputs_are_checked_before_anything_is_read(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.io.read", pytest.fail)
    for name, words in (
        ("a.jpg", "stored as .pfm"),
        ("a/b.ply", "without folders"),
        ("result.npz", "another output"),
        ("disparity.png", "another output"),
    ):
        refused(lfgpu("depth", recorded, "-o", tmp_path / "out", "--save", name), words)
    for command in (["depth"], ["export-scene"], ["export"], ["live"], ["depth", "--save", "input_Cam004.png"]):
        refused(lfgpu(*command, recorded, "-o", recorded / ".." / recorded.name), "which is the input")
    refused(lfgpu("live", recorded, "--record", recorded), f"{recorded}, which is the input")
    tiles = recorded / "input_Cam004.png"
    refused(lfgpu("depth", tiles, "-o", recorded, "--save", tiles.name), "which is the input")
    assert not list(tmp_path.iterdir())


def test_a_second_run_reads_no_more_views_than_the_first(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[Path] = []
    monkeypatch.setattr("lfgpu.io.views.read_view", lambda file: [decoded.append(file), read_view(file)][1])
    for run in (1, 2):
        said("depth", recorded, "-o", tmp_path, "--save", "mine.tif", "--views", "column", "--preset", "fast", *RANGE)
        assert len(decoded) == 3 * run


def test_views_and_maps_that_are_read_stay(
    recorded: Path, solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, truth = tmp_path / "rows", tmp_path / "maps" / "disparity.pfm"
    for n in range(9):
        (rows / f"row{n // 3}").mkdir(parents=True, exist_ok=True)
        shutil.copy(recorded / f"input_Cam{n:03d}.png", rows / f"row{n // 3}" / f"{n % 3}.png")
    truth.parent.mkdir()
    shutil.copy(recorded / "gt_disp_lowres.pfm", truth)
    views = "".join(f'[[views]]\nfile = "{u}.png"\nposition = [{u}, 0]\n' for u in range(3))
    told = f"{views}[truth]\ndisparity = '../../maps/disparity.pfm'\nposition = [1, 0]\n"
    description = rows / "row1" / "some.toml"
    description.write_text(told, encoding="utf-8")
    shutil.copy(solved / "result.npz", tmp_path / "maps")
    scene = tmp_path / "scene"
    export_scene(read(recorded), load(solved), scene)
    pictures = tuple(map(str, sorted((scene / "images").iterdir())))
    write_description(replace(read(recorded), files=pictures), scene / "lightfield.toml", source={})
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    fast = ("--preset", "fast", *RANGE)
    for command in (
        ("depth", rows, "-o", rows / "row1", "--save", "0.png", "--views", "column", *fast),
        ("depth", description, "-o", rows / "row1", "--save", "0.png", *fast),
        ("depth", description, "-o", truth.parent, *fast),
        ("render", description, "--view", "0,1", "-o", rows / "row1" / "0.png", *fast),
        ("convert", solved, "--image", rows, "-o", rows / "row1" / "0.png"),
        ("export-scene", scene / "lightfield.toml", "-o", scene, "--maps", solved),
        ("rectify", scene, "-o", scene / "images"),
        ("rectify", scene / "lightfield.toml", "-o", scene / "images", "--equalise"),
    ):
        refused(lfgpu(*command), "is part of the input: it would be written over")
    refused(lfgpu("convert", truth.parent, "-o", truth.parent / "result.npz"), "which is the input")
    monkeypatch.setattr("lfgpu.io.views.read_view", pytest.fail)
    refused(lfgpu("depth", rows, "-o", rows / "row1", "--save", "0.png", *fast), "is part of the input")
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_convert(recorded: Path, solved: Path, tmp_path: Path) -> None:
    maps = load(solved / "disparities.npz")
    said("convert", solved, "-o", tmp_path / "a.tif")
    np.testing.assert_array_equal(load(tmp_path / "a.tif").disparity, maps.reference.disparity)
    said("convert", solved / "disparities.npz", "--view", "0,2", "-o", tmp_path / "b.ply", "--image", recorded)
    cloud = trimesh.load(tmp_path / "b.ply", process=False)
    known = np.isfinite(maps.disparities[2])
    np.testing.assert_array_equal(cloud.metadata["_ply_raw"]["vertex"]["data"]["disparity"], maps.disparities[2][known])
    assert known.mean() > 0.99
    np.testing.assert_array_equal(cloud.colors[:, :3], read(recorded).views[2][known])
    with pytest.raises(LightFieldError, match="index of a view must be a whole number from -9 to 8"):
        maps.map(9)
    # all views' clouds are of one frame: where both see the same, their points are the same
    a, b = (point_cloud(maps.map(n)).points for n in (2, 4))
    distance = np.linalg.norm(b[:, None, :] - a[None, ::7], axis=2).min(0)
    assert (distance > 0.1).mean() < 0.08  # metres, at 4 to 8 m, pixels being 0.05 to 0.1 m apart
    assert distance.max() < 0.4

    for words, *wrong in (
        ("no map of a view at row 9", solved / "disparities.npz", "--view", "9,9", "-o", tmp_path / "c.tif"),
        ("holds a single map", solved, "--view", "1,1", "-o", tmp_path / "c.tif"),
        ("stored as .pfm", solved, "-o", tmp_path / "c.jpg"),
        ("No such file", tmp_path / "none.npz", "-o", tmp_path / "c.tif"),
        ("does not say which view", solved / "map.pfm", "-o", tmp_path / "c.ply", "--image", recorded),
    ):
        refused(lfgpu("convert", *wrong), words)
    assert {file.name for file in tmp_path.iterdir()} == {"a.tif", "b.ply"}


def test_render_images(recorded: Path, solved: Path, tmp_path: Path) -> None:
    lf, maps = read(recorded), load(solved / "disparities.npz")
    assert "filled from their surroundings" in said(
        "render", recorded, "--maps", solved, "--view", "0.5,1.25", "-o", tmp_path / "v.png"
    )
    said("render", recorded, "--refocus", "0.7", "-o", tmp_path / "r.png")
    said("render", recorded, "--maps", solved, "--all-in-focus", "--reference-view", "0,1", "-o", tmp_path / "a.png")
    expected = {"v.png": render_view(lf, maps, 0.5, 1.25).image, "r.png": refocus(lf, 0.7)}
    for name, image in expected.items():
        stored = np.asarray(Image.open(tmp_path / name))
        np.testing.assert_allclose(stored / 255, image, atol=0.51 / 255)
    in_focus = np.asarray(Image.open(tmp_path / "a.png")) / 255
    assert np.abs(in_focus - lf.image(1)).mean() < 0.02


@pytest.fixture(scope="module")
def loose(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six of the views, one after the other and from right to left: only options say how they stand."""
    file = tmp_path_factory.mktemp("loose") / "views.npy"
    lf = read(recorded)
    np.save(file, lf.views.reshape(3, 3, *lf.views.shape[1:])[:2, ::-1].reshape(6, *lf.views.shape[1:]))
    return file


READ = ("--format", "numpy", "--grid", "2x3", "--flip", "u")


def test_render_reads_as_depth_does(recorded: Path, loose: Path, tmp_path: Path) -> None:
    refused(lfgpu("render", loose, "--refocus", "0.7", "-o", tmp_path / "r.png"), "6 views")
    said("render", loose, *READ, "--reference-view", "1,1", "--refocus", "0.7", "-o", tmp_path / "r.png")
    lf = read(loose, grid=(2, 3), flip="u")
    expected = refocus(lf.with_reference(lf.index_of(1, 1)), 0.7)
    stored = np.asarray(Image.open(tmp_path / "r.png")) / 255
    np.testing.assert_allclose(stored, expected, atol=0.51 / 255)
    np.testing.assert_array_equal(lf.view(1, 1), read(recorded).view(1, 1))
    for option in (("--every", "2"), ("--format", "nonsense"), ("--flip", "w"), ("--grid", "2")):
        outcome = lfgpu("render", loose, *option, "--refocus", "0.7", "-o", tmp_path / "no.png")
        refused(outcome, option[0].strip("-"))


@pytest.mark.parametrize("name", [name if name == "fast" else thorough(name) for name in PRESETS])
def test_render_with_any_preset(name: str, recorded: Path, tmp_path: Path) -> None:
    said("render", recorded, "--view", "1,0.5", "-o", tmp_path / f"{name}.png", "--preset", name, *RANGE, "-q")
    assert Image.open(tmp_path / f"{name}.png").size == (56, 48)


@pytest.mark.parametrize("sweep", ["circle", "across", "down", "focus"])
def test_render_films(sweep: str, recorded: Path, solved: Path, tmp_path: Path) -> None:
    said("render", recorded, "--maps", solved, "--sweep", sweep, "--frames", 4, "-o", tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.n_frames, film.size) == (4, (56, 48))
        first = np.asarray(film.convert("RGB")).astype(float)
        film.seek(1)
        assert np.abs(np.asarray(film.convert("RGB")) - first).mean() > 2  # it moves


def test_wrong_options_of_render(recorded: Path, solved: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    for words, *options in (
        ("give one of", "-o", out),
        ("give one of", "--view", "1,1", "--refocus", "1", "-o", out),
        ("circle, across, down, focus", "--sweep", "square", "-o", tmp_path / "a.gif"),
        (".png or .tif", "--view", "1,1", "-o", tmp_path / "a.gif"),
        (".gif or .mp4", "--sweep", "circle", "-o", out),
        ("which is the input", "--sweep", "circle", "-o", recorded),
        ("ROW,COL such as", "--view", "middle", "-o", out),
        ("too far away", "--maps", solved, "--view", "1,99", "-o", out),
        ("must be a number", "--refocus", "inf", "-o", out),
        ("does not hold maps of all views", "--maps", solved / "result.npz", "--view", "1,1", "-o", out),
        ("frames per second", "--sweep", "focus", "--maps", solved, "--fps", "0", "-o", tmp_path / "a.gif"),
    ):
        refused(lfgpu("render", recorded, *options), words)
    assert not list(tmp_path.iterdir())

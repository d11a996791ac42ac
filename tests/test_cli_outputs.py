"""`lfgpu depth --save`, `convert`, `render`, and `eval` of what they wrote."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from typer.testing import CliRunner

import lfgpu
from lfgpu import PRESETS, scenes
from lfgpu.cli import app
from lfgpu.io import write_hci

RANGE = ("--disparity-range", "-2,2")
SAVED = ("map.exr", "map.tif", "map16.png", "cloud.ply", "map.npz", "map.pfm")


def run(*arguments: object) -> str:
    """Run a command that succeeds and return its output."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(words: str, *arguments: object) -> None:
    """Exactly one sentence on stderr, with those words in it."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 1, result.output
    assert re.fullmatch(r"lfgpu: [^\n]*\.\n", result.stderr), result.stderr
    assert words in result.stderr


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "boxes"
    write_hci(scenes.make("boxes", grid=(3, 3), size=(48, 56), seed=1), folder)
    return folder


@pytest.fixture(scope="module")
def solved(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("solved") / "out"
    saves = [word for name in SAVED for word in ("--save", name)]
    said = run("depth", recorded, "-o", out, "--all-views", "--preset", "fast", *RANGE, *saves)
    assert all(name in said for name in SAVED)
    return out


def scores(said: str) -> list[str]:
    """The last row of the table of scores, without its name."""
    rows = [line.split() for line in said.splitlines() if line.count(" %") == 4]
    return rows[-1][1:]


def test_every_saved_map_scores_as_the_result_does(recorded: Path, solved: Path) -> None:
    read = [name for name in SAVED if not name.endswith(".ply")]
    true, *found = (scores(run("eval", path, recorded)) for path in (solved, *(solved / name for name in read)))
    for name, one in zip(read, found, strict=True):
        if name == "map16.png":
            np.testing.assert_allclose(float(one[0]), float(true[0]), rtol=0.01)
        else:
            assert one == true, name


def test_maps_of_all_views_are_scored(recorded: Path, solved: Path) -> None:
    lf, maps = lfgpu.read(recorded), lfgpu.load(solved / "disparities.npz")
    metrics = lfgpu.evaluate(maps.disparities[lf.reference_index], lf.truth.disparity)
    found = scores(run("eval", solved / "disparities.npz", recorded))
    assert float(found[0]) == pytest.approx(metrics.mse_100, abs=1e-3)
    assert scores(run("eval", solved / "disparities.npz", recorded / "gt_disp_lowres.pfm")) == found


def test_the_cloud_has_the_colours_of_the_view(recorded: Path, solved: Path) -> None:
    lf, result = lfgpu.read(recorded), lfgpu.load(solved)
    cloud = trimesh.load(solved / "cloud.ply", process=False)
    np.testing.assert_array_equal(cloud.colors[:, :3], lf.views[lf.reference_index].reshape(-1, 3))
    np.testing.assert_allclose(cloud.vertices[:, 2], result.depth.ravel(), rtol=1e-6)


def test_outputs_of_an_earlier_run_go_and_other_files_stay(recorded: Path, loose: Path, tmp_path: Path) -> None:
    out, last = tmp_path / "out", tmp_path / "last"
    fast = ("--preset", "fast", *RANGE, "-q")
    run("depth", recorded, "-o", out, "--all-views", "--report", "--save", "mine.tif", *fast)
    names = {path.name for path in out.iterdir()}
    assert {"depth.pfm", "disparities.npz", "report.html"} < names
    refused("no view", "depth", loose, *READ, "-o", out, "--reference-view", "9,9", *fast)
    assert {path.name for path in out.iterdir()} == names
    for folder in (out, last):
        run("depth", loose, *READ, "-o", folder, *fast)
    assert {path.name for path in out.iterdir()} == {*(path.name for path in last.iterdir()), "mine.tif"}


def test_names_to_save_are_checked_before_anything_is_read(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.io.read", pytest.fail)
    for name, words in (
        ("a.jpg", "stored as .pfm"),
        ("a/b.ply", "without folders"),
        ("result.npz", "another output"),
        ("disparity.png", "another output"),
    ):
        refused(words, "depth", recorded, "-o", tmp_path / "out", "--save", name)
    assert not list(tmp_path.iterdir())


def test_convert(recorded: Path, solved: Path, tmp_path: Path) -> None:
    maps = lfgpu.load(solved / "disparities.npz")
    run("convert", solved, "-o", tmp_path / "a.tif")
    np.testing.assert_array_equal(lfgpu.load(tmp_path / "a.tif").disparity, maps.reference.disparity)
    run("convert", solved / "disparities.npz", "--view", "0,2", "-o", tmp_path / "b.ply", "--image", recorded)
    cloud = trimesh.load(tmp_path / "b.ply", process=False)
    known = np.isfinite(maps.disparities[2])
    np.testing.assert_array_equal(cloud.metadata["_ply_raw"]["vertex"]["data"]["disparity"], maps.disparities[2][known])
    assert known.mean() > 0.99
    np.testing.assert_array_equal(cloud.colors[:, :3], lfgpu.read(recorded).views[2][known])
    # all views' clouds are of one frame: where both see the same, their points are the same
    a, b = (lfgpu.point_cloud(maps.map(n)).points for n in (2, 4))
    distance = np.linalg.norm(b[:, None, :] - a[None, ::7], axis=2).min(0)
    assert (distance > 0.1).mean() < 0.08  # metres, at 4 to 8 m, pixels being 0.05 to 0.1 m apart
    assert distance.max() < 0.4

    refused(
        "no map of a view at row 9", "convert", solved / "disparities.npz", "--view", "9,9", "-o", tmp_path / "c.tif"
    )
    refused("holds a single map", "convert", solved, "--view", "1,1", "-o", tmp_path / "c.tif")
    refused("stored as .pfm", "convert", solved, "-o", tmp_path / "c.jpg")
    refused("No such file", "convert", tmp_path / "none.npz", "-o", tmp_path / "c.tif")
    refused("does not say which view", "convert", solved / "map.pfm", "-o", tmp_path / "c.ply", "--image", recorded)
    assert {file.name for file in tmp_path.iterdir()} == {"a.tif", "b.ply"}


def test_render_images(recorded: Path, solved: Path, tmp_path: Path) -> None:
    lf, maps = lfgpu.read(recorded), lfgpu.load(solved / "disparities.npz")
    assert "filled from their surroundings" in run(
        "render", recorded, "--maps", solved, "--view", "0.5,1.25", "-o", tmp_path / "v.png"
    )
    run("render", recorded, "--refocus", "0.7", "-o", tmp_path / "r.png")
    run("render", recorded, "--maps", solved, "--all-in-focus", "--reference-view", "0,1", "-o", tmp_path / "a.png")
    expected = {
        "v.png": lfgpu.render_view(lf, maps, 0.5, 1.25).image,
        "r.png": lfgpu.refocus(lf, 0.7),
    }
    for name, image in expected.items():
        stored = np.asarray(Image.open(tmp_path / name))
        np.testing.assert_allclose(stored / 255, image, atol=0.51 / 255)
    in_focus = np.asarray(Image.open(tmp_path / "a.png")) / 255
    assert np.abs(in_focus - lf.image(1)).mean() < 0.02


@pytest.fixture(scope="module")
def loose(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six of the views, one after the other and from right to left: only options say how they stand."""
    file = tmp_path_factory.mktemp("loose") / "views.npy"
    lf = lfgpu.read(recorded)
    np.save(file, lf.views.reshape(3, 3, *lf.views.shape[1:])[:2, ::-1].reshape(6, *lf.views.shape[1:]))
    return file


READ = ("--format", "numpy", "--grid", "2x3", "--flip", "u")


def test_render_reads_as_depth_does(recorded: Path, loose: Path, tmp_path: Path) -> None:
    refused("6 views", "render", loose, "--refocus", "0.7", "-o", tmp_path / "r.png")
    run("render", loose, *READ, "--reference-view", "1,1", "--refocus", "0.7", "-o", tmp_path / "r.png")
    lf = lfgpu.read(loose, grid=(2, 3), flip="u")
    expected = lfgpu.refocus(lf.with_reference(lf.index_of(1, 1)), 0.7)
    stored = np.asarray(Image.open(tmp_path / "r.png")) / 255
    np.testing.assert_allclose(stored, expected, atol=0.51 / 255)
    np.testing.assert_array_equal(lf.view(1, 1), lfgpu.read(recorded).view(1, 1))
    for option in (("--every", "2"), ("--format", "nonsense"), ("--flip", "w"), ("--grid", "2")):
        refused(option[0].strip("-"), "render", loose, *option, "--refocus", "0.7", "-o", tmp_path / "no.png")


@pytest.mark.parametrize(
    "name", [name if name in ("fast", "paper") else pytest.param(name, marks=pytest.mark.thorough) for name in PRESETS]
)
def test_render_with_any_preset(name: str, recorded: Path, tmp_path: Path) -> None:
    run("render", recorded, "--view", "1,0.5", "-o", tmp_path / f"{name}.png", "--preset", name, *RANGE, "-q")
    assert Image.open(tmp_path / f"{name}.png").size == (56, 48)


@pytest.mark.parametrize("sweep", ["circle", "across", "down", "focus"])
def test_render_films(sweep: str, recorded: Path, solved: Path, tmp_path: Path) -> None:
    run("render", recorded, "--maps", solved, "--sweep", sweep, "--frames", 4, "-o", tmp_path / "a.gif")
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
        ("ROW,COL such as", "--view", "middle", "-o", out),
        ("too far away", "--maps", solved, "--view", "1,99", "-o", out),
        ("must be a number", "--refocus", "inf", "-o", out),
        ("does not hold maps of all views", "--maps", solved / "result.npz", "--view", "1,1", "-o", out),
        ("frames per second", "--sweep", "focus", "--maps", solved, "--fps", "0", "-o", tmp_path / "a.gif"),
    ):
        refused(words, "render", recorded, *options)
    assert not list(tmp_path.iterdir())

"""Maps in every format: what is written comes back, others can open it, and it is written whole or not at all."""

import re
import resource
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image
from samples import refusal
from typer.testing import CliRunner

import lfgpu
from lfgpu.cli import app
from lfgpu.data import DepthResult, DisparityMap, Geometry, ViewsResult
from lfgpu.io import MAP_FORMATS, holds_map, load, read_map, save
from tests.made import made_result

RNG = np.random.default_rng(3)
SHAPE = (5, 7)
SLOPE = np.linspace(-1, 1, 40 * 60, dtype=np.float32).reshape(40, 60)
GEOMETRY = Geometry(500.0, 0.05, 4.25, (3.0, 2.5), 1.25, (1.0, 2.0))
SUFFIXES = [suffix for entry in MAP_FORMATS if entry.write is not None for suffix in entry.suffixes]
READ = [suffix for suffix in SUFFIXES if suffix != ".ply"]
WITH_METADATA = [suffix for suffix in READ if suffix != ".pfm"]
WITH_CONFIDENCE = (".npz", ".exr")


def a_map(**changes: Any) -> DisparityMap:
    disparity = RNG.uniform(-2, 3, SHAPE).astype(np.float32)
    disparity[1, 2] = np.nan
    values = DisparityMap(
        disparity,
        RNG.random(SHAPE).astype(np.float32),
        position=(4.0, 3.5),
        geometry=GEOMETRY,
        name="Käse & $dollars$\nover two lines",
        versions={"lfgpu": "0.1.0", "numpy": "2.0"},
    )
    return replace(values, **changes)


def a_result() -> DepthResult:
    disparity, confidence = RNG.random((2, *SHAPE)).astype(np.float32)
    return made_result(disparity, confidence, position=(1.0, 0.0), geometry=GEOMETRY, name="scene")


def maps_of_all_views() -> ViewsResult:
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.5]])
    disparities, confidences = RNG.random((2, 3, *SHAPE)).astype(np.float32)
    return ViewsResult(disparities, confidences, positions, (1, 0), a_result(), {"keys": 1.0, "total": 2.5})


def assert_same(found: Any, written: Any) -> None:
    assert type(found) is type(written)
    for name, value in vars(written).items():
        other = getattr(found, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value)
            assert other.dtype == value.dtype
        elif name == "stages":
            assert list(other) == list(value)
            for stage in value:
                np.testing.assert_array_equal(other[stage], value[stage])
        elif name == "reference":
            assert_same(other, value)
        else:
            assert other == value, name


# --- what is written comes back ---


@pytest.mark.parametrize("suffix", READ)
def test_the_map_comes_back(suffix: str, tmp_path: Path) -> None:
    written, path = a_map(), tmp_path / f"map{suffix.upper()}"
    written.save(path)
    assert holds_map(path)
    assert not holds_map(tmp_path / f"nowhere{suffix}")
    found = load(path)
    assert isinstance(found, DisparityMap)
    step = 0.5 * (np.nanmax(written.disparity) - np.nanmin(written.disparity)) / 65534 if suffix == ".png" else 0
    np.testing.assert_allclose(found.disparity, written.disparity, rtol=0, atol=1.01 * step)
    assert found.disparity.dtype == np.float32
    np.testing.assert_array_equal(read_map(path), found.disparity)
    if suffix in WITH_METADATA:
        about = [(m.position, m.geometry, m.name, m.versions) for m in (found, written)]
        assert about[0] == about[1]
    if suffix in WITH_CONFIDENCE:
        known = np.isfinite(written.disparity)
        np.testing.assert_array_equal(found.confidence[known], written.confidence[known])


def test_a_result_is_saved_as_its_map(tmp_path: Path) -> None:
    written = a_result()
    written.save(tmp_path / "map.tif")
    found = load(tmp_path / "map.tif")
    np.testing.assert_array_equal(found.disparity, written.disparity)
    assert found.position == written.position


@pytest.mark.parametrize("suffix", WITH_METADATA)
def test_what_is_not_known_stays_so(suffix: str, tmp_path: Path) -> None:
    written = DisparityMap(np.full(SHAPE, 1.5, np.float32))  # of one value: a PNG has no range to spread
    written.save(tmp_path / f"map{suffix}")
    found = load(tmp_path / f"map{suffix}")
    np.testing.assert_array_equal(found.disparity, written.disparity)
    assert (found.confidence, found.position, found.geometry) == (None, None, None)


def test_maps_of_all_views_come_back(tmp_path: Path) -> None:
    written = maps_of_all_views()
    lfgpu.save(written, tmp_path / "all.npz")
    found = lfgpu.load(tmp_path / "all.npz")
    assert_same(found, written)
    one = written.map(2)
    assert one.position == (2.0, 0.5)
    one.save(tmp_path / "one.exr")
    np.testing.assert_array_equal(read_map(tmp_path / "one.exr"), written.disparities[2])
    assert "choose one with .map(index)" in refusal(lambda: written.save(tmp_path / "all.pfm"))


@pytest.mark.parametrize(
    ("array", "value", "said"),
    [
        ("positions", np.float64(3), "positions is float64 of shape (), not float64 (3, 2)"),
        ("positions", np.zeros((2, 2)), "positions is float64 of shape (2, 2), not float64 (3, 2)"),
        ("positions", np.full((3, 2), np.nan), "positions are not finite"),
        ("disparities", np.float32(3), "disparities is float32 of shape (), not float32 (0, 5, 7)"),
        ("confidences", np.zeros((3, *SHAPE)), "confidences is float64 of shape (3, 5, 7), not float32 (3, 5, 7)"),
        ("keys", np.array([0, 3]), "keys name views beyond the 3 that it has"),
        ("keys", np.int64(0), "iteration over a 0-d array"),
        ("timings", np.array('{"total": null}'), "damaged result"),
        ("timings", np.array("[1]"), "damaged result"),
    ],
)
def test_damaged_maps_of_all_views_are_refused(array: str, value: Any, said: str, tmp_path: Path) -> None:
    path = tmp_path / "views.npz"
    maps_of_all_views().save(path)
    with np.load(path) as loaded:
        arrays = {name: loaded[name] for name in loaded.files}
    np.savez(path, **{**arrays, array: value})
    text = refusal(lambda: load(path))
    assert "is a damaged result of lfgpu" in text
    assert said in text


def test_a_folder_that_depth_wrote(tmp_path: Path) -> None:
    written = a_result()
    written.save(tmp_path / "result.npz")
    assert_same(load(tmp_path), written)
    written.map.save(tmp_path / "disparity.pfm")
    assert_same(load(tmp_path), written)  # which tells more
    (tmp_path / "result.npz").unlink()
    np.testing.assert_array_equal(load(tmp_path).disparity, written.disparity)
    (tmp_path / "empty").mkdir()
    assert "holds neither result.npz nor disparity.pfm" in refusal(lambda: load(tmp_path / "empty"))


# --- what is a map and what a light field ---


@pytest.mark.parametrize("name", ["depth", "original_depth", "confidence_000003"])
def test_a_pfm_of_something_else_is_not_taken_for_disparity(name: str, tmp_path: Path) -> None:
    save(a_map(), tmp_path / f"{name}.pfm")
    assert "by its name" in refusal(lambda: load(tmp_path / f"{name}.pfm"))
    read_map(tmp_path / f"{name}.pfm")  # in the unit of the file


def test_light_fields_with_suffixes_of_maps_are_none(tmp_path: Path) -> None:
    views = np.zeros((2, 2, *SHAPE, 3), np.uint8)
    np.save(tmp_path / "views.npy", views)
    np.savez(tmp_path / "views.npz", views=views)
    tifffile.imwrite(tmp_path / "views.tif", views.reshape(4, *SHAPE, 3), photometric="rgb")
    Image.fromarray(views[0, 0]).save(tmp_path / "views_eslf.png")
    (tmp_path / "damaged.npy").write_bytes(b"no array")
    for file in tmp_path.iterdir():
        assert not holds_map(file), file
    np.save(tmp_path / "map.npy", views[0, 0, ..., 0])
    maps_of_all_views().save(tmp_path / "all.npz")
    assert holds_map(tmp_path / "map.npy")
    assert holds_map(tmp_path / "all.npz")


def test_commands_name_the_formats_of_the_table() -> None:
    for command in ("depth", "convert"):
        said = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout
        for entry in MAP_FORMATS:
            assert (entry.suffixes[0] in said) == (entry.write is not None), (command, entry.suffixes)


# --- others can open it ---


def test_others_open_the_tiff(tmp_path: Path) -> None:
    written = a_map()
    written.save(tmp_path / "map.tif")
    with tifffile.TiffFile(tmp_path / "map.tif") as file:
        np.testing.assert_array_equal(file.asarray(), written.disparity)
        assert file.asarray().dtype == np.float32
        assert "larger is nearer" in file.pages[0].description
    tifffile.imwrite(tmp_path / "other.tif", written.disparity, description="not ours")
    np.testing.assert_array_equal(read_map(tmp_path / "other.tif"), written.disparity)


def test_others_open_the_exr(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    exr = pytest.importorskip("OpenEXR")
    for geometry, named in ((None, {"disparity", "confidence"}), (GEOMETRY, {"disparity", "confidence", "Z"})):
        written = a_map(geometry=geometry)
        written.save(tmp_path / "map.exr")
        with exr.File(str(tmp_path / "map.exr")) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
            about = str(file.header()["lfgpu"])
        assert "larger is nearer" in about
        assert (set(channels), '"Z"' in about) == (named, "Z" in named)
    np.testing.assert_array_equal(channels["Z"], written.depth)
    with exr.File({}, {"Y": written.disparity}) as file:
        file.write(str(tmp_path / "other.exr"))
    np.testing.assert_array_equal(read_map(tmp_path / "other.exr"), written.disparity)
    with exr.File({}, {"a": written.disparity, "b": written.disparity}) as file:
        file.write(str(tmp_path / "two.exr"))
    assert "it holds a, b" in refusal(lambda: read_map(tmp_path / "two.exr"))
    DisparityMap(SLOPE).save(tmp_path / "map.exr")
    data = (tmp_path / "map.exr").read_bytes()
    (tmp_path / "map.exr").write_bytes(data[:-200] + bytes(200))
    words = refusal(lambda: load(tmp_path / "map.exr"))
    assert re.search("map.exr cannot be read as OpenEXR: (its pixels are damaged|Unable to run decoder)", words)  # 3.4
    assert capfd.readouterr() == ("", "")


def test_others_open_the_png(tmp_path: Path) -> None:
    written = a_map()
    written.save(tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        assert np.asarray(image).max() == 65535
        assert "disparity = offset + scale * value" in image.text["lfgpu"]
    Image.fromarray(np.ones(SHAPE, np.uint16)).save(tmp_path / "other.png")
    assert "what its values mean" in refusal(lambda: read_map(tmp_path / "other.png"))


@pytest.mark.parametrize(
    ("dtype", "geometry"), [(np.uint8, GEOMETRY), (np.uint16, GEOMETRY), (np.float32, GEOMETRY), (np.uint8, None)]
)
def test_others_open_the_cloud(dtype: Any, geometry: Geometry | None, tmp_path: Path) -> None:
    written = a_map(geometry=geometry)
    image = RNG.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    scale = {np.uint8: 1, np.uint16: 257, np.float32: np.float32(1 / 255)}[dtype]
    save(written, tmp_path / "cloud.ply", image=(image * dtype(scale)).astype(dtype))
    cloud = trimesh.load(tmp_path / "cloud.ply", process=False)
    known = np.isfinite(written.disparity)
    if geometry is None:
        y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
        points = np.stack([x - 3.0, y - 2.0, -written.disparity], axis=-1)
    else:
        points = geometry.points(written.disparity, position=written.position)
        assert known.sum() == known.size - 1
    np.testing.assert_allclose(cloud.vertices, points[known], rtol=1e-6)
    np.testing.assert_array_equal(cloud.colors[:, :3], image[known])
    assert b"metres" in (tmp_path / "cloud.ply").read_bytes()[:200] or geometry is None
    vertices = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(written.disparity[vertices["row"], vertices["column"]], vertices["disparity"])


def test_a_cloud_without_geometry_is_no_flat_sheet(tmp_path: Path) -> None:
    save(DisparityMap(SLOPE), tmp_path / "a.ply")
    points = trimesh.load(tmp_path / "a.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert 0.2 * 60 < np.ptp(points["z"]) < 0.6 * 60
    np.testing.assert_allclose(points["z"], -8 * points["disparity"])
    assert b"z is -8 times the disparity" in (tmp_path / "a.ply").read_bytes()


def test_a_cloud_needs_points_and_an_image_of_its_size(tmp_path: Path) -> None:
    path, nothing = tmp_path / "cloud.ply", a_map(disparity=np.full(SHAPE, np.nan, np.float32))
    for map_, image, words in (
        (a_map(), np.zeros((2, 2, 3), np.uint8), "5 x 7 pixels; found (2, 2, 3)"),
        (a_map(), np.zeros((*SHAPE, 3), np.int64), "found int64"),
        (nothing, None, "so the point cloud is empty"),
    ):
        assert words in refusal(lambda map_=map_, image=image: save(map_, path, image=image))
    assert not path.exists()


def test_points_of_little_confidence_can_be_left_out() -> None:
    values = a_map()
    assert values.confidence is not None
    cloud = lfgpu.point_cloud(values, least_confidence=0.5)
    assert cloud.metric
    assert len(cloud.points) == (np.isfinite(values.disparity) & (values.confidence >= 0.5)).sum()
    grey = lfgpu.point_cloud(values, image=np.full(SHAPE, 7, np.uint8))
    assert grey.colors is not None
    assert (grey.colors == 7).all()


# --- whole or not at all ---


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_leaves_what_was_there(suffix: str, tmp_path: Path) -> None:
    big = DisparityMap(RNG.random((300, 300)).astype(np.float32))
    path = tmp_path / f"map{suffix}"
    path.write_text("mine")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))  # the system refuses what goes beyond
    try:
        text = refusal(lambda: big.save(path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert f"{path} cannot be written" in text
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    for name in ("map.jpg", "map", "map.npy"):
        assert "stored as .pfm, .npz, .png, .tif, .exr, .ply" in refusal(
            lambda name=name: save(a_map(), tmp_path / name)
        )
    assert "[y, x]" in refusal(lambda: save(DisparityMap(np.zeros(3, np.float32)), tmp_path / "a.tif"))
    for suffix in ("pfm", "npz"):
        bare = refusal(lambda suffix=suffix: save(np.zeros((4, 5)), tmp_path / f"a.{suffix}"))  # type: ignore[arg-type]
        assert "or a map: lfgpu.DisparityMap(disparity); found ndarray" in bare
    assert not list(tmp_path.iterdir())


def test_without_openexr_it_is_said_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a_map().save(tmp_path / "a.exr")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for action in (lambda: load(tmp_path / "a.exr"), lambda: a_map().save(tmp_path / "b.exr")):
        assert "pip install 'lfgpu[exr]'" in refusal(action)


# --- damaged files ---


def test_metadata_that_lie_are_refused(tmp_path: Path) -> None:
    a_map().save(tmp_path / "map.tif")
    whole = (tmp_path / "map.tif").read_bytes()
    (tmp_path / "map.tif").write_bytes(whole.replace(b'"content": "disparity"', b'"content": "depthdept"'))
    assert "damaged" in refusal(lambda: load(tmp_path / "map.tif"))
    written = maps_of_all_views()
    replace(written, disparities=written.disparities[:, :2]).save(tmp_path / "all.npz")
    assert "disparities is float32 of shape (3, 2, 7)" in refusal(lambda: load(tmp_path / "all.npz"))

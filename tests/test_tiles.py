"""Tiles: the same map as in one piece, within the memory that is given, from views that stay on disk."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu, refused, said
from PIL import Image

from benchmarks import tile_differences
from lfgpu import DepthResult, LightField, LightFieldError, estimate_depth, read, scenes
from lfgpu._backends import load, open_device
from lfgpu.config import Config
from lfgpu.contract import REDUCTION, Device
from lfgpu.data.mapping import forget, is_mapped
from lfgpu.io import read_map, write_hci
from lfgpu.io.disk import on_disk
from lfgpu.methods import footprint, method_of, preset
from lfgpu.methods.footprint import PROCESS, Footprint, parse_memory
from lfgpu.methods.measured import Measured
from lfgpu.pipelines import tiles
from lfgpu.pipelines.pipeline import DepthPipeline
from lfgpu.pipelines.resident import KEPT
from lfgpu.pipelines.verdict import map_notes
from tests.made import masked, thorough

ROOT = Path(__file__).parents[1]
RANGE = (-0.8, 0.8)
TOLERANCE = 1e-3  # pixels per view step
SIDE = 490  # pixels


@pytest.fixture(scope="module")
def scene() -> LightField:
    """With noise, so that nothing is as it is by chance, and larger than two tiles and their halos."""
    return scenes.make("boxes", grid=(3, 3), size=(SIDE, SIDE), disparity_range=(-0.7, 0.7), noise=0.01, seed=5)


@pytest.fixture(scope="module")
def parameters(scene: LightField) -> Config:
    """With the noise of the whole scene, so that all tiles have the same."""
    measured = method_of("accurate").measure(scene, Device(load("warp"), "cpu"), disparity_range=RANGE)
    assert measured.disparity_range == RANGE
    assert measured.noise is not None
    return preset("accurate").with_values({"sweep.noise": measured.noise})


@pytest.fixture(scope="module")
def whole(scene: LightField, parameters: Config) -> DepthResult:
    return estimate_depth(scene, config=parameters, disparity_range=RANGE, device="cpu")


@pytest.fixture(scope="module")
def strip(scene: LightField) -> LightField:
    """Wide enough for two tiles of the preset that looks less far."""
    return scene.crop(slice(0, 64), slice(0, 400))


@pytest.fixture(scope="module")
def quick(parameters: Config) -> Config:
    return preset("fast").with_values({"sweep.noise": parameters.sweep.noise})  # type: ignore[attr-defined]


def halo(lf: LightField, config: Config) -> tuple[int, int]:
    return method_of(config).halo(lf.layout, given(lf, config))


def given(lf: LightField, config: Config) -> Measured:
    return method_of(config).given(lf.layout, RANGE) or Measured(RANGE)


def memory_for(lf: LightField, config: Config, height: int, width: int) -> int:
    """Return the memory for which tiles of that size are the largest that fit."""
    needed = method_of(config).footprint(lf.layout, given(lf, config), on_gpu=False).bytes(height, width)
    return needed + lf.views.nbytes + 4 * 8 * lf.size[0] * lf.size[1]


def in_tiles(lf: LightField, config: Config, memory: int) -> DepthResult:
    return estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu", max_memory=memory)


# --- the map ---


def test_tiles_give_the_map_that_is_found_in_one_piece(
    scene: LightField, parameters: Config, whole: DepthResult
) -> None:
    edge = halo(scene, parameters)
    (_, height), (_, width) = (tiles._cuts(side, e)[1] for side, e in zip(scene.size, edge, strict=True))
    found = in_tiles(scene, parameters, memory_for(scene, parameters, height, width))
    assert found.status.startswith(f"4 tiles of {width} x {height} pixels")
    for name, values in {**whole.stages, "disparity": whole.disparity, "confidence": whole.confidence}.items():
        ours = {**found.stages, "disparity": found.disparity, "confidence": found.confidence}[name]
        assert np.abs(ours - values).max() < TOLERANCE, name
    np.testing.assert_allclose(found.uncertainty, whole.uncertainty, rtol=0.01)
    assert found.name == scene.name
    assert found.geometry == scene.geometry
    assert found.disparity_range == RANGE
    assert {*whole.timings} == {*found.timings}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("size", "share"),
    [
        ((384, 384), 0.0), ((390, 410), 0.5), ((401, 433), 0.9), ((64, 900), 0.1), ((900, 64), 0.3),
        ((333, 520), 0.6), ((520, 333), 0.2), ((450, 450), 0.0), ((371, 612), 0.4), ((480, 390), 0.8),
    ],
)  # fmt: skip
def test_every_limit_between_the_smallest_tiles_and_one_piece_gives_tiles(size: tuple[int, int], share: float) -> None:
    """`share` of the way from the least memory to that of one piece."""
    lf = scenes.make("boxes", grid=(3, 3), size=size, disparity_range=(-0.7, 0.7), noise=0.01, seed=sum(size))
    config = preset("fast").with_values({"sweep.noise": 0.01})
    cuts = [tiles._cuts(side, edge)[-1][1] for side, edge in zip(size, halo(lf, config), strict=True)]
    least, most = memory_for(lf, config, *cuts), memory_for(lf, config, *size)
    found = in_tiles(lf, config, int(least + share * (most - least)))
    assert " tiles of " in found.status
    expected = estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu")
    for name, values in {**expected.stages, "confidence": expected.confidence}.items():
        ours = found.confidence if name == "confidence" else found.stages[name]
        assert np.abs(ours - values).max() < TOLERANCE, name


def test_a_light_field_that_is_too_large_for_the_machine_is_estimated_in_tiles(
    strip: LightField, quick: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = {"config": quick, "disparity_range": RANGE, "device": "cpu"}
    whole = method_of(quick).footprint(strip.layout, given(strip, quick), on_gpu=False).bytes(*strip.size)
    free = whole - PROCESS - strip.views.nbytes
    monkeypatch.setattr(footprint, "free_memory", lambda: free)
    assert estimate_depth(strip, **options).notes == ()
    KEPT.free()  # which would go on without a plan of its own
    monkeypatch.setattr(footprint, "free_memory", lambda: free - 1)
    found = estimate_depth(strip, **options)
    assert " tiles of " in found.status
    assert found.notes == (
        f"The map was made in tiles: in one piece it takes about {whole / 2**30:.3g} GiB of memory, and there are "
        f"{free / 2**30:.3g} GiB.",
    )
    expected = in_tiles(strip, quick, whole + strip.views.nbytes - 1)
    np.testing.assert_array_equal(found.disparity, expected.disparity)
    with pytest.raises(LightFieldError, match=r"a map in one piece takes about .* GiB: use fewer or smaller views"):
        DepthPipeline(strip, **options)
    KEPT.free()
    with pytest.raises(LightFieldError, match=r"a tile takes .* GiB: set max_memory"):
        estimate_depth(strip, **options, max_memory="8GiB")
    monkeypatch.setattr(footprint, "free_memory", lambda: None)  # the system does not say
    assert " tiles of " not in estimate_depth(strip, **options).status


@pytest.mark.thorough
def test_patches_without_texture_are_those_found_in_one_piece() -> None:
    """As far as halos reach beyond them: from what their paths bring along. Filling stops by the residual of a tile."""
    rows = {
        row["stage"]: row
        for row in tile_differences.run(["fast"], [tile_differences.Scene("textureless", (370, 390), 0.01)])
    }
    assert rows["sweep"]["largest"] <= 1e-6
    assert rows["align"]["largest"] <= 1e-6
    assert 0 < rows["boundaries"]["largest"] < 1e-3


def test_tiles_are_doubted_together() -> None:
    """Their map, not that of the first one, lies at the end of its range."""
    lf, bounds = scenes.make("boxes", grid=(3, 3), size=(64, 380)), (0.5, 3.0)
    method = method_of("fast")
    measured = method.measured(lf, bounds, open_device("warp", "cpu"))
    (_, width) = tiles._cuts(380, method.halo(lf.layout, measured)[1])[1]
    memory = method.footprint(lf.layout, measured, on_gpu=False).bytes(64, width) + lf.views.nbytes + 32 * 64 * 380
    found = estimate_depth(lf, config="fast", disparity_range=bounds, device="cpu", max_memory=memory)
    assert " tiles of " in found.status
    assert any("lies at its far end" in note for note in found.notes)
    assert set(map_notes(found.disparity, found.confidence, bounds)) <= set(found.notes)


@pytest.mark.thorough
def test_without_a_halo_the_map_would_differ(
    scene: LightField, parameters: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The comparison can fail."""
    part = scene.crop(slice(0, 200), slice(0, 200))
    whole = estimate_depth(part, config=parameters, disparity_range=RANGE, device="cpu")
    monkeypatch.setattr(type(method_of(parameters)), "halo", lambda *_: (1, 1))
    found = in_tiles(part, parameters, memory_for(part, parameters, 48, 48))
    assert np.abs(found.disparity - whole.disparity).max() > 10 * TOLERANCE


@pytest.mark.parametrize("config", ["accurate", "fast", "paper"])
def test_the_halo_holds_what_is_looked_at_and_what_may_hide_it(config: str) -> None:
    """Along each axis: the largest shift in any view, and the largest difference of shifts."""
    lf = scenes.make("planes", grid=(3, 7), size=(32, 40))  # up to 1 step down and 3 to the right
    method = method_of(config)

    def found(low: float, high: float) -> tuple[int, int]:
        return method.halo(lf.layout, Measured((low, high)))

    (y, x), reach = found(-1, 2), np.array([1, 3])
    assert np.array_equal(np.subtract(found(0, 2), (y, x)), -1 * reach)  # the same shifts, with less between them
    assert np.array_equal(np.subtract(found(-2, 1), (y, x)), 0 * reach)  # the same on the other side
    assert np.array_equal(np.subtract(found(2, 5), (y, x)), 3 * reach)  # as much between larger shifts
    assert found(-0.1, 0.1)[0] == y - 5 + 2  # parts of a pixel count as one
    assert y - 5 >= 16 + 2 * (method.config.prior.window // 2)  # and windows, paths or solvers


def test_noise_and_range_are_those_of_the_whole(scene: LightField) -> None:
    """So that a light field in one tile is estimated as it is without the limit."""
    part = scene.crop(slice(0, 160), slice(0, 160))
    plain = estimate_depth(part, config="fast", device="cpu")
    limited = estimate_depth(part, config="fast", device="cpu", max_memory="8GiB")
    assert limited.status.startswith("In one piece: ")
    assert limited.disparity_range == plain.disparity_range
    assert np.array_equal(limited.disparity, plain.disparity)
    assert np.array_equal(limited.confidence, plain.confidence)


def test_several_devices_give_the_same(strip: LightField, quick: Config) -> None:
    """Each in a thread with a pipeline of its own, here twice the CPU."""
    plan = tiles.plan_tiles(strip.size, halo(strip, quick), Footprint(1.0, 0), 64 * 400)
    assert len(plan.starts) > 1
    options = {"config": quick, "disparity_range": RANGE, "backend": "warp", "deterministic": False}
    one = tiles._estimate_all(strip, method_of(quick), plan, ["cpu"], options, None)
    two = tiles._estimate_all(strip, method_of(quick), plan, ["cpu", "cpu"], options, None)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.disparity, b.disparity)


def test_a_tile_that_shows_nothing_does_not_end_the_others(strip: LightField, quick: Config) -> None:
    views = strip.views.copy()
    views[:, :, :360] = 0
    dark = replace(strip, views=views, truth=None)
    width = tiles._cuts(400, halo(dark, quick)[1])[-1][1]
    assert width < 360
    found = in_tiles(dark, quick, memory_for(dark, quick, 64, width))
    assert "have no estimate" in found.status
    assert np.isnan(found.disparity[:, 0]).all()
    assert (found.confidence[:, 0] == 0).all()
    assert np.isfinite(found.disparity[:, 399]).all()


def test_masks_are_those_of_each_tile(strip: LightField, quick: Config) -> None:
    lf = masked(strip, np.s_[:, 20:40, 30:50])
    hole = ~lf.valid[lf.reference_index]
    whole = estimate_depth(lf, config=quick, disparity_range=RANGE, device="cpu")
    found = in_tiles(lf, quick, memory_for(lf, quick, 64, tiles._cuts(400, halo(lf, quick)[1])[1][1]))
    assert found.status.startswith("2 tiles")
    np.testing.assert_array_equal(np.isnan(found.disparity), hole)
    assert np.nanmax(np.abs(found.disparity - whole.disparity)) < TOLERANCE
    assert (found.confidence[hole] == 0).all()


# --- the plan ---


@pytest.mark.parametrize("size", [(64, 64), (480, 640), (1000, 333)])
@pytest.mark.parametrize("edge", [(3, 5), (40, 17)])
@pytest.mark.parametrize("share", [0.3, 0.6, 2.0])
def test_every_pixel_is_in_a_tile_beyond_its_halo(size: tuple[int, int], edge: tuple[int, int], share: float) -> None:
    limit = int(share * size[0] * size[1]) + 150 * 150
    plan = tiles.plan_tiles(size, edge, Footprint(1 / 1.1, 0), limit)
    assert plan.size[0] * plan.size[1] <= limit + 1
    total = np.zeros(size)
    for top, left in plan.starts:
        assert 0 <= top <= size[0] - plan.size[0]
        assert 0 <= left <= size[1] - plan.size[1]
        assert top % REDUCTION == left % REDUCTION == 0  # so that reduced views are those of the whole
        total[top : top + plan.size[0], left : left + plan.size[1]] += tiles._weights(size, plan, (top, left))
    assert total.min() > 0


def test_several_devices_share_what_would_fit_on_one() -> None:
    needed = Footprint(1 / 1.1, 0)
    assert len(tiles.plan_tiles((960, 1280), (40, 40), needed, 960 * 1280).starts) == 1
    assert len(tiles.plan_tiles((960, 1280), (40, 40), needed, 960 * 1280, devices=4).starts) == 4
    assert len(tiles.plan_tiles((100, 100), (40, 40), needed, 960 * 1280, devices=4).starts) == 1


def test_estimates_that_agree_are_mixed_and_others_are_not() -> None:
    join, ones = tiles._Join((1, 4), 0.1), np.ones((1, 4), np.float32)
    join.add(1.0 * ones, 0.75 * ones, (0, 0))
    join.add(np.array([[1.08, 3.0, np.nan, 1.0]], np.float32), 0.25 * ones, (0, 0))
    assert np.allclose(join.values, [[1.02, 1.0, 1.0, 1.0]])
    join.add(5.0 * ones, 2.0 * ones, (0, 0))
    assert np.allclose(join.values, 5.0)


# --- the memory ---


def test_sizes_are_understood_and_others_refused() -> None:
    assert [parse_memory(text) for text in ("8GiB", "500 MB", "1.5g", "64")] == [2**33, 5 * 10**8, 15 * 10**8, 64]
    assert [parse_memory(number) for number in (77, 6e8, np.int64(99))] == [77, 6 * 10**8, 99]
    for wrong in (
        "",
        "much",
        "-1GiB",
        "0",
        "8 GiB x",
        0,
        True,
        float("inf"),
        float("nan"),
        -5.0,
        10**400,
        f"{10**400}k",
    ):
        with pytest.raises(LightFieldError, match="max_memory must be a size"):
            parse_memory(wrong)


def test_too_little_memory_is_an_error_that_says_how_much_it_takes(scene: LightField) -> None:
    with pytest.raises(
        LightFieldError,
        match=r"no tile fits into 401 MiB of memory: 5\d\d MiB are needed, of which 500 MiB are for the process",
    ):
        estimate_depth(scene, config="fast", disparity_range=RANGE, device="cpu", max_memory="420MB")


_MEASURE = """
import sys
import numpy as np
from benchmarks.memory import host_peak, reset_host_peak
from lfgpu import DepthPipeline, LightField
from lfgpu.methods import method_of
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.verdict import map_notes

name, device = sys.argv[1:]
on_gpu = device != "cpu"

def run(height, width):
    views = np.random.default_rng(0).integers(0, 256, (5, 5, height, width, 3), np.uint8)
    lf = LightField.from_grid(views)
    method = method_of(name)
    measured = Measured((-1.5, 1.5), 0.01)
    used = lf.subset(method.used_views(lf.offsets))
    del lf, views
    pipeline = DepthPipeline(used, config=name, measured=measured, device=device)
    pipeline.estimate()
    pipeline.run()
    pipeline.run()
    pipeline.disparity()
    return method.footprint(used.layout, measured, on_gpu=on_gpu)

if on_gpu:  # where others may use the GPU as well: without the context
    import warp

    needed = run(448, 672)
    print(0, needed.bytes(448, 672) - needed.besides, warp.get_mempool_used_mem_high(device), 0)
else:
    small = run(48, 48).bytes(48, 48)
    reset_host_peak()
    before = host_peak()
    foreseen = run(336, 448).bytes(336, 448) - small
    print(before, foreseen, host_peak() - before, small)
"""


def test_what_is_taken_where_there_is_room_has_an_end() -> None:
    needed = Footprint(1 / 1.1, 7, 2 / 1.1, round(300 / 1.1))
    assert [needed.bytes(10, width) for width in (1, 10, 20, 30)] == [37, 307, 507, 607]


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is measured as Linux counts it")
@pytest.mark.parametrize("device", ["cpu", "cuda:0"])
@pytest.mark.parametrize("name", ["fast", "accurate", "surest", "paper"])
def test_memory_is_as_foreseen(name: str, device: str) -> None:
    if device not in load("warp").devices():
        pytest.skip(f"no {device} here")
    command = [sys.executable, "-c", _MEASURE, name, device]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    before, foreseen, grown, small = map(int, done.stdout.splitlines()[-1].split())
    assert before <= small
    assert 0.75 * foreseen < grown < 1.05 * foreseen


# --- the command ---


def test_depth_takes_a_limit(scene: LightField, tmp_path: Path) -> None:
    write_hci(scene.crop(slice(0, 60), slice(0, 64)), tmp_path / "in")
    base = ["depth", tmp_path / "in", "--preset", "fast", "--disparity-range", "-1,1", "--device", "cpu"]
    assert "In one piece" in said(*base, "-o", tmp_path / "out", "--max-memory", "2GiB")
    plain = estimate_depth(read(tmp_path / "in"), config="fast", disparity_range=(-1, 1), device="cpu")
    assert np.array_equal(read_map(tmp_path / "out" / "disparity.pfm"), plain.disparity)
    for options, words in (
        (["--max-memory", "lots"], "max_memory must be a size"),
        (["--max-memory", "2GiB", "--all-views"], "--max-memory works for the map of one view only"),
    ):
        refused(lfgpu(*base, "-o", tmp_path / "not", *options), words)
        assert not (tmp_path / "not").exists()


# --- views on disk ---


def test_views_on_disk_are_those_in_memory(scene: LightField, tmp_path: Path) -> None:
    small = scene.crop(slice(0, 40), slice(0, 44))
    write_hci(small, tmp_path / "folder")
    np.save(tmp_path / "file.npy", small.views.reshape(3, 3, *small.views.shape[1:]))
    (tmp_path / "lightfield.toml").write_text('[source]\npath = "folder"\nformat = "hci"\n')
    for name in ("folder", "file.npy", "lightfield.toml"):
        plain, lazy = read(tmp_path / name), read(tmp_path / name, lazy=True)
        assert is_mapped(lazy.views)
        assert not is_mapped(plain.views)
        forget(lazy.views)  # it is read again
        assert np.array_equal(lazy.views, plain.views)
        assert lazy.notes == plain.notes
        assert is_mapped(lazy.crop(slice(3, 9), slice(2, 8)).views)
    assert not list(tmp_path.glob("lfgpu-*"))


def resident_of_files() -> int:
    """Bytes of files that this process has mapped and in memory."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssFile"))
    return 1024 * int(line.split()[1])


@pytest.mark.skipif(sys.platform != "linux", reason="what is in memory is measured as Linux counts it")
@pytest.mark.parametrize("dtype", [np.uint8, thorough(np.float32)])
def test_what_was_looked_at_is_forgotten(dtype: type, tmp_path: Path) -> None:
    """When the light field is read, shrunk, and cut into tiles, of which the pages hold far more than the pixels."""
    rng = np.random.default_rng(0)
    shape = (3, 15, 300, 2000, 3)
    views = rng.integers(0, 256, shape, np.uint8)
    np.save(tmp_path / "views.npy", views if dtype is np.uint8 else (views / 255).astype(dtype))
    before = resident_of_files()
    lf = read(tmp_path / "views.npy", lazy=True)
    assert is_mapped(lf.views)
    assert lf.views.nbytes > 2**26
    lf.downsampled(4)
    tile = tiles._tile(lf, range(45), (10, 20), (200, 100))
    assert resident_of_files() - before < 2**24
    expected = views.reshape(45, *shape[2:])[:, 10:210, 20:120]
    assert np.array_equal(tile.views, expected if dtype is np.uint8 else (expected / 255).astype(dtype))
    assert lf.views[:, ::50, ::50].sum() > 0
    assert np.asarray(lf.views).sum() > 0
    touched = resident_of_files() - before
    assert touched > 0.9 * lf.views.nbytes  # that the measurement can fail


def test_what_users_write_into_their_mapped_views_stays(tmp_path: Path) -> None:
    np.save(tmp_path / "views.npy", np.full((3, 3, 40, 48, 3), 200, np.uint8))
    views = np.load(tmp_path / "views.npy", mmap_mode="c")
    views[1, 1, :8] = 0
    lf = LightField.from_grid(views)
    assert not is_mapped(lf.views)
    assert lf.downsampled(2).views[4, 0, 0, 0] == 0
    forget(lf.views)
    assert views[1, 1, 0, 0, 0] == 0


def test_a_file_that_ends_too_early_is_refused_where_it_is_mapped(tmp_path: Path) -> None:
    path = tmp_path / "file.npy"
    np.save(path, np.zeros((3, 3, 16, 16, 3), np.uint8))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(LightFieldError, match=re.escape("file.npy cannot be read as NumPy data: it ends too early")):
        read(path, lazy=True)


def test_views_that_do_not_fit_onto_the_disk_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in range(4):
        Image.fromarray(np.full((8, 9, 3), place, np.uint8)).save(tmp_path / f"v_{place // 2}_{place % 2}.png")
    monkeypatch.setattr("lfgpu.io.disk.shutil.disk_usage", lambda _: type("Usage", (), {"free": 100}))
    with pytest.raises(LightFieldError, match="set TMPDIR to a folder with more"):
        read(tmp_path, lazy=True)
    with on_disk(False):
        assert not is_mapped(read(tmp_path).views)

"""The contents of the viewer: maps, their scales, the facts about them, and saved files."""

import gc
import json
from pathlib import Path

import numpy as np
import pytest
from walls import SIZE, wall

from lfgpu import scenes
from lfgpu.data import DisparityMap, Geometry
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_hci, write_pfm
from lfgpu.viewer import saving
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import LIVE, TRUTH, Contents, Entry, opened, opened_all
from lfgpu.viewer.facts import Facts, fixed
from lfgpu.viewer.pictures import histogram


def test_compared_maps_have_one_scale() -> None:
    contents = Contents(
        None, {name: Entry(DisparityMap(np.full(SIZE, value, np.float32))) for name, value in (("a", -3), ("b", 2))}
    )
    low, high = contents.limits("disparity")
    assert low <= -3
    assert high >= 2
    assert contents.free_name("a") == "a 2"
    assert contents.free_name("c") == "c"


def test_paths_are_taken_in_any_order(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    write_hci(lf, tmp_path / "lf")
    write_pfm(tmp_path / "map.pfm", lf.truth.disparity + 0.1)
    contents = opened_all([tmp_path / "map.pfm", tmp_path / "lf"])
    assert list(contents.all_entries()) == ["map", TRUTH]
    error = contents.map("map", "error")
    assert error is not None
    np.testing.assert_allclose(error, 0.1, atol=1e-5)
    alone = opened_all([tmp_path / "map.pfm"])
    assert alone.size == SIZE
    assert alone.map("map", "error") is None


@pytest.mark.parametrize("suffix", [".npz", ".tif"])
def test_what_a_file_says_of_its_map_is_shown(suffix: str, tmp_path: Path) -> None:
    geometry = Geometry(50.0, 0.1, 2.0)
    values = DisparityMap(
        np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE),
        np.full(SIZE, 0.5, np.float32),
        position=(1.0, 2.0),
        geometry=geometry,
    )
    values.save(tmp_path / f"map{suffix}")
    contents = opened(tmp_path / f"map{suffix}", Contents())
    assert contents.geometry == geometry
    assert contents.position == (1.0, 2.0)
    depth, confidence = contents.map("map", "depth"), contents.map("map", "confidence")
    assert depth is not None
    np.testing.assert_allclose(depth, geometry.depth(values.disparity), rtol=1e-3)
    assert (confidence is not None) == (suffix == ".npz")
    assert confidence is None or (confidence == 0.5).all()


def test_a_map_brings_the_reference_view_along(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    write_hci(lf, tmp_path / "lf")
    DisparityMap(np.zeros(SIZE, np.float32), position=(2.0, 0.0)).save(tmp_path / "map.npz")
    contents = opened_all([tmp_path / "lf", tmp_path / "map.npz"])
    assert contents.position == (2.0, 0.0)


def test_what_does_not_belong_is_refused(tmp_path: Path) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    write_hci(lf, tmp_path / "lf")
    write_pfm(tmp_path / "small.pfm", np.zeros((5, 6)))
    with pytest.raises(LightFieldError, match="6 x 5 pixels, what is shown has 32 x 24"):
        opened_all([tmp_path / "lf", tmp_path / "small.pfm"])
    with pytest.raises(LightFieldError, match="second light field"):
        opened_all([tmp_path / "lf", tmp_path / "lf"])
    with pytest.raises(LightFieldError, match=r"nowhere\.pfm does not exist"):
        opened(tmp_path / "nowhere.pfm", Contents())
    with pytest.raises(LightFieldError, match="does not exist"):
        opened(tmp_path / "nowhere", Contents())


def test_scores_belong_to_their_frame() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(40, 48))
    board = Board()
    board.show(lf, DisparityMap(lf.truth.disparity + 0.1), name="mine")
    scores = board.contents.scores("mine")
    assert scores.badpix_07 == 100
    board.update(lf.truth.disparity)  # of an unknown frame
    assert board.contents.scores(LIVE) is None
    assert board.contents.map(LIVE, "error") is None
    assert board.contents.scores("mine") is not None
    board.update(lf.truth.disparity, views=lf.views[::-1].copy())
    assert board.contents.truth is None
    assert board.contents.scores("mine") is None
    assert board.contents.map(LIVE, "error") is None
    facts = {one["name"]: one for one in Facts(board).now()["results"]}
    assert (facts["mine"]["earlier"], facts[LIVE]["earlier"]) == (True, False)
    assert TRUTH not in facts


def test_what_is_unknown_is_in_no_scale_and_no_bin() -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    disparity[0, 0], disparity[0, 1] = np.nan, np.inf
    contents = Contents(None, {"a": Entry(DisparityMap(disparity)), "b": Entry(DisparityMap(disparity * np.nan))})
    low, high = contents.limits("disparity")
    assert -1 <= low < high <= 1
    assert contents.extent("disparity") == pytest.approx((disparity[0, 2], 1))
    assert contents.extent("confidence") is None
    values = np.array([[0.1, 0.1, 0.9, 5.0, np.nan]], np.float32)
    np.testing.assert_allclose(histogram(values, 0.0, 1.0, 2), [50, 25])
    board = Board()
    board.show(wall(1.0))
    board.update(np.zeros(SIZE), rate=float("nan"), latency=0.25, dropped=3)
    stream = json.loads(json.dumps(Facts(board).now(), allow_nan=False))["stream"]
    assert (stream["rate"], stream["latency"], stream["dropped"]) == (None, 0.25, 3)


def test_facts_are_plain_and_say_what_is_the_truth() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    board = Board()
    facts = Facts(board)
    assert json.loads(json.dumps(facts.now(), allow_nan=False))["size"] is None
    board.show(lf)
    (truth,) = json.loads(json.dumps(facts.now(), allow_nan=False))["results"]
    assert truth["isTruth"]
    assert truth["kinds"] == ["disparity", "depth"] if lf.geometry else ["disparity"]
    presets = {one["name"]: one for one in json.loads(json.dumps(fixed(), allow_nan=False))["presets"]}
    sections = {section["name"] for section in presets["paper"]["sections"]}
    assert "refinement" in sections
    assert "semi_global" not in sections  # that of another method


def test_readers_say_what_they_do(tmp_path: Path) -> None:
    write_hci(scenes.make("relief", grid=(3, 3), size=SIZE), tmp_path / "lf")
    board, said = Board(), list[str]()
    board.listen(lambda: said.append(board.loading[0] if board.loading else "done"))
    board.load([tmp_path / "lf"])
    assert said[0] == "Reading lf"
    assert "Reading lf: 9 of 9 views" in said
    assert said[-1] == "done"


def test_a_listener_that_fails_keeps_nobody_from_knowing() -> None:
    board, heard = Board(), list[bool]()
    board.listen(lambda: 1 / 0)
    end = board.listen(lambda: heard.append(True))
    board.tell()
    end()
    board.tell()
    assert heard == [True]


def test_pages_switch_what_a_stream_offers() -> None:
    board, switched = Board(), list[bool]()
    board.offer(pause=switched.append)
    board.switch("pause", True)
    assert board.stream.paused
    board.switch("pause", False)
    assert switched == [True, False]
    with pytest.raises(LightFieldError, match="record"):
        board.switch("record", True)


@pytest.mark.parametrize("suffix", [".npz", ".pfm", ".exr", ".png", ".tif"])
def test_results_are_saved_as_the_package_saves_them(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR") if suffix == ".exr" else None
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    contents = Contents(
        lf, {"mine": Entry(DisparityMap(np.full(SIZE, 0.5, np.float32), np.full(SIZE, 0.9, np.float32)))}
    )
    path = tmp_path / f"saved{suffix}"
    path.write_bytes(saving.saved(contents, "mine", "final", suffix))
    np.testing.assert_allclose(read_map(path), 0.5, atol=1e-4)
    for wrong in (".jpg", f"/../../escaped{suffix}", ""):
        with pytest.raises(LightFieldError, match="cannot be written"):
            saving.saved(contents, "mine", "final", wrong)
    with pytest.raises(LightFieldError, match="no result"):
        saving.saved(contents, "other", "final", suffix)


def test_pictures_are_of_the_frame_that_a_page_was_told() -> None:
    board = Board()
    board.show(wall(1.0))
    facts = Facts(board)
    told, kept = facts.newest()
    lf = board.contents.lf
    board.update(np.zeros(SIZE), views=np.zeros_like(lf.views))
    assert facts.contents(told["revision"]) is kept
    newer, contents = facts.newest()
    assert newer["revision"] != told["revision"]
    assert facts.contents(newer["revision"]) is contents is board.contents
    del kept, lf
    gc.collect()
    assert facts.contents(told["revision"]) is None  # nobody keeps it


@pytest.mark.parametrize(("low", "high", "bins"), [(1.0, 1.0, 5), (0.0, 1.0, 0), (0.0, 1.0, 10**6)])
def test_a_distribution_needs_bins(low: float, high: float, bins: int) -> None:
    with pytest.raises(LightFieldError, match="there are no"):
        histogram(np.zeros(SIZE, np.float32), low, high, bins)

"""Public names explain themselves: short texts, names that type checkers know, sentences for wrong types."""

import importlib.metadata
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import BackendName, backend_named, list_backends
from lfgpu.data import DepthResult, DisparityMap, ViewsResult
from lfgpu.machine import version_of
from lfgpu.methods import PRESETS, PresetName
from lfgpu.metrics import Sparsification, evaluate, sparsification
from tests.made import made_result

SIZE = (40, 48)
GEOMETRY = lfgpu.Geometry(50.0, 0.1, 2.0)


def a_light_field(**options: Any) -> lfgpu.LightField:
    return scenes.make("relief", grid=(3, 3), size=SIZE, **options)


def a_result(lf: lfgpu.LightField, error: float = 0.1) -> DepthResult:
    disparity = lf.truth.disparity + np.float32(error)
    position = tuple(lf.positions[lf.reference_index].tolist())
    told = {"disparity_range": (-1.0, 1.0), "timings": {"total": 1.25}, "geometry": GEOMETRY, "name": lf.name}
    return made_result(disparity, position=position, **told)


def maps_of_all_views(lf: lfgpu.LightField) -> ViewsResult:
    maps = np.zeros(lf.views.shape[:3], np.float32)
    return ViewsResult(maps, maps, lf.positions, (4, 0), a_result(lf), {"total": 3.0})


# --- texts ---


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda lf: lf, ("9 views in a grid of 3 x 3", "40 x 48 px", "row 1, column 1", "ground truth")),
        (lambda lf: lf.truth, ("40 x 48 px", "px per view step", "row 1, column 1")),
        (a_result, ("40 x 48 px", "px per view step", " m", "0.50 on average", "matching with warp on cpu, 1.25 s")),
        (lambda lf: a_result(lf).map, ("40 x 48 px", "px per view step", "row 1, column 1")),
        (maps_of_all_views, ("maps of 9 views", "40 x 48 px", "px per view step", "2 key views", "3 s")),
        (lambda lf: evaluate(a_result(lf), lf.truth), ("MSE x100 1.0", "BadPix(0.07) 100.00 %", "over 180 pixels")),
        (lambda lf: sparsification(a_result(lf), np.ones(SIZE), lf.truth), ("AUSE", "180 pixels")),
        (lambda lf: lfgpu.point_cloud(a_result(lf)), ("1920 points", "metres", "z ")),
    ],
    ids=["light field", "truth", "result", "map", "views", "metrics", "sparsification", "points"],
)
def test_a_text_is_short_and_says_what_it_is(made: Callable[[Any], Any], words: tuple[str, ...]) -> None:
    found = made(a_light_field())
    text = repr(found)
    assert text.startswith(f"<{type(found).__name__}")
    assert len(text.splitlines()) <= 3
    assert max(map(len, text.splitlines())) <= 160
    for word in words:
        assert word in text, text


def test_the_text_of_a_map_counts_what_is_unknown() -> None:
    disparity = np.zeros(SIZE, np.float32)
    disparity[:10] = np.nan
    assert "0 to 0 px per view step, 25.00% unknown" in repr(DisparityMap(disparity))
    assert "unknown everywhere" in repr(DisparityMap(np.full(SIZE, np.nan, np.float32)))


def test_a_map_is_made_of_any_numbers_and_of_nothing_else(tmp_path: Path) -> None:
    made = DisparityMap([[1, 2], [3, 4]], np.ma.masked_equal([[0.5, 0.5], [0.5, 0.0]], 0.0))  # type: ignore[arg-type]
    assert made.disparity.dtype == made.confidence.dtype == np.float32
    assert "2 x 2 px" in repr(made)
    made.save(tmp_path / "map.png")
    hidden = DisparityMap(np.ma.masked_equal([[1.0, 9.0]], 9.0))  # what is masked is unknown
    np.testing.assert_array_equal(hidden.disparity, [[1, np.nan]])
    for wrong, sentence in (
        ((np.zeros(3),), r"disparity must be \[y, x\], found shape \(3,\)"),
        ((None,), "disparity must be"),
        (("x",), "disparity must be an array of numbers"),
        ((np.zeros((2, 3), complex),), "disparity must be an array of numbers"),
        ((np.zeros((2, 3)), np.zeros((3, 2))), r"confidence must be \(2, 3\), as the disparity is, found"),
    ):
        with pytest.raises(lfgpu.LightFieldError, match=sentence):
            DisparityMap(*wrong)  # type: ignore[arg-type]


def test_the_text_of_a_viewer() -> None:
    pytest.importorskip("viser")
    lf = a_light_field()
    with lfgpu.Viewer(lf, a_result(lf), port=0) as viewer:
        assert repr(viewer) == f"<Viewer at {viewer.url}: {lf.name!r}, maps result>"
    assert "closed" in repr(viewer)


@pytest.fixture
def versions_anew() -> Iterator[None]:
    """No version that was looked up before is known in the test, and none of the test after it."""
    version_of.cache_clear()
    yield
    version_of.cache_clear()


@pytest.mark.usefixtures("versions_anew")
def test_a_checkout_that_is_not_installed_saves_maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def none(package: str) -> str:
        raise importlib.metadata.PackageNotFoundError(package)

    lf = a_light_field()
    monkeypatch.setattr(importlib.metadata, "version", none)
    assert lfgpu.__version__ == "not installed"
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-1, 1))
    assert result.versions["lfgpu"] == "not installed"
    lfgpu.save(result, tmp_path / "map.tif")  # its metadata say versions


# --- names that type checkers know ---


def test_names_for_type_checkers_are_those_of_the_registries() -> None:
    assert get_args(PresetName) == tuple(PRESETS)
    assert get_args(BackendName) == list_backends()


def test_a_backend_is_named_or_refused() -> None:
    assert backend_named("taichi") == "taichi"
    with pytest.raises(lfgpu.BackendError, match="unknown backend 'cuda'"):
        backend_named("cuda")


@pytest.mark.thorough
@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_type_checkers_refuse_wrong_names_and_types(checker: str, tmp_path: Path) -> None:
    lines = {
        "result = lfgpu.estimate_depth(lf, config='fast', backend='warp')": True,
        "lfgpu.load('x').disparity": False,
        "lfgpu.estimate_depth(lf, config='fats')": False,
        "lfgpu.estimate_depth(lf, backend='wrap')": False,
        "lfgpu.estimate_depth(lf, disparity_range='wide')": False,
        "lfgpu.estimate_dept(lf)": False,
        "result.disparty": False,
        "depth: float = result.confidence": False,
        "first = lfgpu.to_xarray(result).disparity": True,
    }
    code = tmp_path / "code.py"
    code.write_text("import lfgpu\n\n\ndef f(lf: lfgpu.LightField) -> None:\n" + "".join(f"    {x}\n" for x in lines))
    settings = Path(__file__).parents[1] / "pyproject.toml"
    if checker == "mypy":
        pytest.importorskip("mypy")
        command = [sys.executable, "-m", "mypy", "--config-file", str(settings), "--follow-imports=silent", str(code)]
    elif program := shutil.which("pyright"):
        command = [program, "--pythonpath", sys.executable, str(code)]
    else:
        pytest.skip("no pyright: npm install --global pyright")
    done = subprocess.run(command, capture_output=True, text=True, cwd=settings.parent, check=False)
    # The cache of mypy may know the same code by another folder: only the name of the file counts.
    found = {int(line) for line in re.findall(r"/code\.py:(\d+):(?:\d+ -)? error", done.stdout)}
    assert found == {n for n, right in enumerate(lines.values(), 5) if not right}, done.stdout


# --- wrong types ---


@pytest.mark.parametrize(
    "call",
    [
        lfgpu.estimate_depth,
        lfgpu.estimate_all_views,
        lfgpu.DepthPipeline,
        lambda lf: lfgpu.refocus(lf, 0.0),
        lambda lf: lfgpu.all_in_focus(lf, DisparityMap(np.zeros(SIZE, np.float32))),
        lambda lf: lfgpu.render_view(lf, maps_of_all_views(a_light_field()), 0, 0),
        lambda lf: lfgpu.export_pipeline(lf, "nowhere"),
    ],
)
def test_what_is_no_light_field_is_refused_with_a_remedy(call: Callable[[Any], Any]) -> None:
    views = np.zeros((3, 3, *SIZE, 3), np.uint8)
    for found, words in (
        (views, r"found ndarray of shape \(3, 3, 40, 48, 3\); make one first: lfgpu.LightField.from_grid\(views\)"),
        ("my/scene", r"found str; read it first: lfgpu.read\('my/scene'\)"),
        (Path("my/scene"), r"read it first: lfgpu.read\('my/scene'\)"),
        (None, "found NoneType"),
    ):
        with pytest.raises(lfgpu.LightFieldError, match=words):
            call(found)


def test_a_result_is_scored_against_the_truth_of_its_light_field() -> None:
    lf = a_light_field()
    assert lf.truth is not None
    result, truth = a_result(lf), lf.truth
    mask = np.zeros(SIZE, np.bool_)
    mask[16:20, 16:20] = True
    masked = lfgpu.GroundTruth(truth.disparity, truth.position, mask)
    for estimate in (result, result.map, result.disparity):
        assert evaluate(estimate, truth) == evaluate(result.disparity, truth.disparity)
        assert evaluate(estimate, masked).count == 16
        assert evaluate(estimate, truth, mask=mask).count == 16
        assert evaluate(estimate, masked, mask=np.ones(SIZE, np.bool_)) == evaluate(estimate, truth)
    curve = sparsification(result, result.confidence, masked)
    assert isinstance(curve, Sparsification)
    assert curve.count == 16


def test_what_cannot_be_scored_is_a_sentence() -> None:
    lf = a_light_field()
    result = a_result(lf)
    other = lfgpu.GroundTruth(lf.truth.disparity, (0.0, 2.0))
    for estimate, truth, words in (
        (result, None, "there is no ground truth"),
        (result, other, "the view at row 1, column 1, the truth of the one at row 2, column 0"),
        ("map.pfm", lf.truth, "disparity must be a DepthResult, a DisparityMap or an array"),
        (result, lf, "truth must be the GroundTruth of a light field or an array .* found LightField"),
    ):
        with pytest.raises(lfgpu.LightFieldError, match=words):
            evaluate(estimate, truth)  # type: ignore[arg-type]


# --- rows and columns ---


def test_a_view_is_named_by_row_and_column() -> None:
    lf = a_light_field()
    maps = maps_of_all_views(lf)
    assert maps.index_of(0, 2) == lf.index_of(0, 2) == 2
    np.testing.assert_array_equal(lf.view(0, 2), lf.views[2])
    assert lfgpu.render_view(lf, maps, 0, 2).position == (2.0, 0.0)  # (u, v)

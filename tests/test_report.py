"""The report, comparisons and notebooks: what stands in them is what was found, and nothing comes from elsewhere."""

import base64
import csv
import io
import re
import shlex
from dataclasses import replace
from datetime import datetime
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import lfgpu, refused, said
from PIL import Image

from lfgpu import ViewsResult, explain, reasons, scenes, write_report
from lfgpu.cli.console import comparison, output
from lfgpu.comparison import Scene, table
from lfgpu.config import parameters
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import load, write_hci, write_pfm
from lfgpu.machine import device_name
from lfgpu.methods import PRESETS, method_of
from lfgpu.metrics import Reliability, evaluate
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.reports import charts
from lfgpu.reports.epis import Point, epi_cards, find_points
from lfgpu.reports.report import Origin, html
from lfgpu.viz import sheets
from lfgpu.viz.cards import limits_of, scale_of
from lfgpu.viz.colours import LOOKS, UNDEFINED, painted
from tests.made import made_result

RANGE = "--disparity-range=-2,2"


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(48, 56))


@pytest.fixture(scope="module")
def folder(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes, and what two methods found in them."""
    place = tmp_path_factory.mktemp("compared")
    for name, scene in (("one", lf), ("two", scenes.make("planes", grid=(3, 3), size=(48, 56)))):
        write_hci(scene, place / name)
        for method, error in (("good", 0.006), ("bad", 0.05)):
            (place / method).mkdir(exist_ok=True)
            write_pfm(place / method / f"{name}.pfm", scene.truth.disparity + error)
    return place


class Links(HTMLParser):
    """The tags and addresses in a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]


# --- the report ---


def pictures(page: str) -> list[np.ndarray]:
    """The pictures that stand in a page, [y, x, 3]."""
    found = []
    for data in re.findall(r'(?:src|href)="data:image/\w+;base64,([^"]*)"', page):
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            found.append(np.asarray(image.convert("RGB")))
    return found


def result_of(lf: LightField, disparity: np.ndarray | None = None, **changes: Any) -> DepthResult:
    """A result that was not computed: by default the ground truth."""
    disparity = lf.truth.disparity if disparity is None else disparity
    timings = {"compile": 3.0, "sweep": 1.0, "total": 4.0}
    told = {"position": lf.truth.position, "timings": timings, "versions": {"lfgpu": "1.2.3"}, "name": lf.name}
    return made_result(disparity, 0.9, **(told | changes))


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_report_says_all_and_needs_no_network(preset: str, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    more = ["--set=refinement.max_iterations=3"] if preset == "paper" else []
    assert said("depth", folder / "one", "-o", out, "--preset", preset, RANGE, "--report", "-q", *more) == ""
    page = (out / "report.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert not links.tags & {"script", "link", "iframe", "object"}
    assert links.addresses
    assert all(address.startswith("data:image/") for address in links.addresses if not address.startswith("#"))
    assert "@import" not in page
    assert all(address.startswith("#") for address in re.findall(r"url\(([^)]*)\)", page))
    assert set(re.findall(r"https?://[^/]*", page)) == {"http://www.w3.org"}, "names of SVG, which nobody fetches"
    assert all(min(picture.shape[:2]) > 10 for picture in pictures(page))
    result = load(out / "result.npz")
    for name, _ in parameters(result.config):
        assert f"<code>{name}</code>" in page
    for version in result.versions.values():
        assert version in page
    for stage in method_of(result.config).stages:
        assert f"<td>{stage.label}</td>" in page
    truth = scenes.make("boxes", grid=(3, 3), size=(48, 56)).truth
    m = evaluate(result.disparity, truth.disparity)
    assert f"<b>{m.mse_100:.3f} " in page
    assert f"<b>{m.badpix_07:.2f} " in page
    assert ("Energy of the refinement" in page) == (preset == "paper")
    assert ('refinement.max_iterations</code></td><td class="n changed">3' in page) == (preset == "paper")
    words = escape(shlex.join(["lfgpu", "depth", str(folder / "one"), "-o", str(out), "--preset", preset, RANGE]))
    assert words in page
    assert f"<td>{folder / 'one'}</td>" in page
    assert f"{datetime.now().astimezone():%B %Y}" in page
    product = device_name(result.device)
    assert product is None or f"{result.device} ({product})" in page
    assert "away from where the cameras&#39; positions put them" in page


def test_names_cannot_break_out_of_the_page(lf: LightField) -> None:
    named = replace(lf, name="<script>x</script>", truth=None, geometry=None)
    result = result_of(lf, name="<script>x</script>")
    page = html(named, result, origin=Origin("<script>", "<script>"))
    assert "<script>" not in page
    assert "Ground truth" not in page


def test_places_that_are_meant_to_be_empty_are_not_missing(lf: LightField) -> None:
    cross = lf.subset([lf.index_of(v, u) for v in range(3) for u in range(3) if 1 in (v, u)])
    assert cross.missing
    assert "missing" not in html(cross, result_of(cross))
    lost = lf.subset([lf.index_of(v, u) for v in range(3) for u in range(3) if (v, u) != (0, 1)])
    assert "1: row 0, column 1 (counted from 0)" in html(lost, result_of(lost))


@pytest.mark.parametrize(
    ("preset", "values", "title", "unit", "first", "scale"),
    [
        ("accurate", (0.3, 0.2, 0.1), "Step of the alignment", "step, px per view step, rms", 1, "linear"),
        ("paper", (30.0, 20.0, 10.0), "Energy of the refinement", "energy", 0, "linear"),
        ("accurate", (0.3, 0.2, 0.001), "Step of the alignment", "step, px per view step, rms", 1, "log"),
    ],
)
def test_the_curve_is_of_what_the_method_traces(
    lf: LightField, preset: str, values: tuple[float, ...], title: str, unit: str, first: int, scale: str
) -> None:
    result = result_of(lf, config=PRESETS[preset], trace=values)
    assert title in html(lf, result)
    assert title not in html(lf, replace(result, trace=values[:1])), "one point is no curve"
    (axes,) = charts.trace(method_of(PRESETS[preset]).traced, np.array(values)).axes
    np.testing.assert_array_equal(axes.lines[0].get_xdata(), first + np.arange(3))
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), values)
    assert (axes.get_ylabel(), axes.get_yscale(), axes.get_xlabel()) == (unit, scale, "iteration")


def test_compilation_is_told_from_the_stages(lf: LightField) -> None:
    page = html(lf, result_of(lf))
    assert "<b>1.00 <span>s</span></b><span>and 3.00 s to compile and load kernels</span>" in page
    assert "compiling and loading kernels</text>" in page
    without = html(lf, result_of(lf, timings={"compile": 0.0, "sweep": 1.0, "total": 1.0}))
    assert "<b>1.00 <span>s</span></b><span>of the estimate</span>" in without
    assert "compil" not in without


def test_undefined_pixels_are_grey_and_out_of_every_scale(lf: LightField) -> None:
    holes = lf.truth.disparity.copy()
    holes[:12, :12] = np.nan
    page = html(lf, result_of(lf, holes, stages={"sweep": holes}, uncertainty=np.where(np.isnan(holes), np.nan, 0.1)))
    maps = [picture for picture in pictures(page) if picture.shape[:2] == lf.size]
    grey = [(picture[:12, :12] == UNDEFINED).all() for picture in maps]
    assert grey == [False, True, False, True, True, True], "view, map, truth, error, confidence, uncertainty"
    assert not any((picture[14:, 14:] == UNDEFINED).all(axis=2).any() for picture in maps[1:])
    assert page.count("grey: undefined") == 4
    limits = limits_of("disparity", holes)
    assert limits[0] >= np.nanmin(holes)
    assert limits[1] <= np.nanmax(holes)


def test_the_range_is_said_with_three_digits(lf: LightField) -> None:
    for values, words in (
        ((-1.534, 1.391), "−1.53 to 1.39"),
        ((0.0, 0.0163), "0.0000 to 0.0163"),
        ((812.4, 1544.9), "812 to 1545"),
        ((), "undefined"),
    ):
        disparity = np.full(lf.size, np.nan, np.float32)
        disparity.flat[: len(values)] = values
        page = html(replace(lf, truth=None), result_of(lf, disparity, stages={}))
        assert f"<span>Disparity</span><b>{words} <" in page


def test_scales_have_arrows_where_values_lie_beyond_them() -> None:
    values = np.linspace(-1, 1, 100, dtype=np.float32).reshape(10, 10)
    for limits, below, above in (((-1, 1), False, False), ((-0.5, 1), True, False), ((-1, 0.5), False, True)):
        scale = scale_of("disparity", values, limits)
        assert (scale.below, scale.above) == (below, above)
        assert scale.stops[0] == "rgb(68 1 84)"
        assert all(0 <= tick.place <= 100 for tick in scale.ticks)
    assert [tick.text for tick in scale_of("error", values, (-1, 1)).ticks] == ["−1", "−0.5", "0", "0.5", "1"]


def test_a_report_does_not_grow_with_the_light_field(rng: np.random.Generator) -> None:
    size = (1200, 1600)
    views = rng.integers(0, 256, (3, *size, 3), dtype=np.uint8)
    lf = LightField(views, np.array([[0, 0], [1, 0], [2, 0]], float), reference=1)
    noise = rng.normal(0, 1, size).astype(np.float32)
    result = made_result(noise, rng.random(size, np.float32), position=(1.0, 0.0), uncertainty=np.abs(noise))
    assert len(html(lf, result)) < 4e6, "noise is what compresses worst"


def test_points_of_epis_are_where_a_map_is_easy_to_judge() -> None:
    lf = scenes.make("planes", grid=(5, 5), size=(96, 128))
    disparity = lf.truth.disparity
    texture, edge = find_points(lf, disparity)
    near = np.s_[texture.y - 3 : texture.y + 4, texture.x - 3 : texture.x + 4]
    assert np.ptp(disparity[near]) < 0.1
    beside = disparity[edge.y, edge.x - 4 : edge.x + 5]
    assert disparity[edge.y, edge.x] - beside.min() > 0.3, "at an edge, on the nearer side"
    holes = np.full_like(disparity, np.nan)
    assert find_points(lf, holes) == []
    assert [point.letter for point in find_points(lf, np.zeros_like(disparity))] == ["A"], "no edge in a plane"
    relief = scenes.make("relief", grid=(7, 7), size=(120, 160))
    assert [point.letter for point in find_points(relief, relief.truth.disparity)] == ["A"], "slopes are no edges"
    row = lf.subset(lf.row())
    for point in find_points(row, disparity):
        assert [card.title for card in epi_cards(row, disparity, point)] == [f"{point.letter}: row {point.y}"]


def test_a_confidence_that_hardly_any_pixel_states_has_no_point() -> None:
    diagram = Reliability(np.array([0.2, 0.9]), np.array([50.0, 90.0]), np.array([0.05, 99.95]), 0.07, 10000)
    (axes,) = charts.reliability(diagram).axes
    (line,) = (line for line in axes.lines if line.get_label() == "found")
    np.testing.assert_array_equal(line.get_xydata(), [[0.9, 90]])
    assert len(axes.patches) == 2


def test_the_line_in_an_epi_follows_the_point() -> None:
    """A white column of pixels on black, which moves by 2 px per view step."""
    views = np.zeros((5, 40, 120, 3), np.uint8)
    offsets = np.arange(-2, 3)
    for n, du in enumerate(offsets):
        views[n, :, 60 - 2 * du] = 255
    lf = LightField(views, np.stack([offsets, 0 * offsets], axis=1).astype(float), reference=2)
    (card,) = epi_cards(lf, np.full((40, 120), 2, np.float32), Point("A", "texture", 60, 20))
    (picture,) = pictures(f'src="{card.image}"')
    xs, ys = (np.array(part, float) for part in zip(*re.findall(r"([\d.]+) ([\d.]+)", card.marks[0].path), strict=True))
    assert len(xs) == 5
    assert (picture[ys.astype(int), xs.astype(int)] == 255).all()
    assert (picture[ys.astype(int), xs.astype(int) - 40] == 0).all()


def test_a_report_with_what_the_judge_says(lf: LightField) -> None:
    views = lf.views.copy()
    views[1] = np.roll(views[1], 1, axis=1)
    moved = replace(lf, views=views)
    found = explain(moved, lf.truth.disparity)
    page = html(lf, result_of(lf), explanation=found)
    assert all(escape(sentence[1:]) in page for sentence in found.findings)
    assert f"{found.mean_psnr:.1f} dB" in page
    assert "Prediction error" in page
    figure, arrow = charts.cameras(found, (20.0, 40.0))
    assert arrow == pytest.approx(np.hypot(*found.shift.T).max())
    (axes,) = figure.axes
    assert len(axes.patches) == len(lf.views)
    (arrows,) = axes.collections
    assert len(arrows.U) == len(lf.views) - 1, "the reference view has none"
    longest = int(np.hypot(arrows.U, arrows.V).argmax())
    assert longest == 1
    np.testing.assert_allclose((arrows.X[1], arrows.Y[1]), lf.positions[1])
    assert np.hypot(arrows.U[1], arrows.V[1]) == pytest.approx(1), "as long as two cameras are apart"
    shown = found._repr_html_()
    assert all(escape(sentence) in shown for sentence in found.findings)
    assert len(pictures(shown)) == 1
    assert "lf-chart" in shown
    row = replace(found, positions=np.stack([np.arange(9.0), np.zeros(9)], axis=1))
    (axes,) = charts.cameras(row, (20.0, 40.0))[0].axes
    assert list(axes.get_yticks()) == [0]
    assert list(axes.get_xticks()) == list(range(9))
    assert "lfgpu check" in html(lf, result_of(lf)), "what says it where the report does not"


# --- comparisons ---


def test_methods_are_compared_on_scenes(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "table"
    both = "--scene", folder / "one", "--scene", folder / "two"
    text = said("eval", folder / "bad", folder / "good", *both, "-o", out)
    assert {file.name for file in out.iterdir()} == {"table.md", "table.tex", "table.csv", "errors.png", "report.html"}
    with (out / "table.csv").open() as file:
        rows = {(row["scene"], row["method"]): row for row in csv.DictReader(file)}
    found = [float(rows["one", method]["MSE x100"]) for method in ("bad", "good")]
    assert found == pytest.approx((0.25, 0.0036), rel=1e-3)
    assert [float(rows["two", method]["BadPix 0.03"]) for method in ("bad", "good")] == [100, 0]
    found = [float(rows["average of 2", method]["Q25 x100"]) for method in ("bad", "good")]
    assert found == pytest.approx((5, 0.6), rel=1e-3)
    assert "| one | good | **0.004** | **0.00** | **0.00** | **0.00** | **0.600** |" in (out / "table.md").read_text()
    assert "| one | bad | 0.250 | **0.00** | 100.00 |" in (out / "table.md").read_text(), "both are best"
    assert r"\textbf{0.004}" in (out / "table.tex").read_text()
    assert re.search(r"one +bad +0\.250", text)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<figure") == 2 * (2 + 2 * 2), "view and truth, then map and error of each method"
    assert "<td>good</td>" in page
    assert len(pictures(page)) == 12


def test_three_methods_and_five_metrics_stand_side_by_side_in_80_columns() -> None:
    truth = np.zeros((48, 56), np.float32)
    maps = {f"a method {n}": truth + np.float32(0.02 * n) for n in range(3)}
    console = output()
    console.width = 80
    with console.capture() as captured:
        comparison(console, table([Scene("a scene", np.zeros((48, 56, 3), np.float32), truth, maps)]))
    lines = [line for line in captured.get().splitlines() if "a method" in line]
    assert [len(re.findall(r"\d+\.\d+", line)) for line in lines] == [5, 5, 5]


def test_a_method_without_a_map_leaves_a_gap(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "one.pfm").write_bytes((folder / "good" / "one.pfm").read_bytes())
    text = said("eval", folder / "bad", tmp_path / "half", "--scene", folder / "one", "--scene", folder / "two")
    assert re.search(r"half +- +- +- +- +-", text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["good", "--scene", "nowhere"], "nowhere does not exist"),
        (["nowhere", "--scene", "one"], "nowhere does not exist"),
        (["good", "good", "--scene", "one"], "two methods are called 'good'"),
        (["good", "--scene", "one", "--scene", "one"], "two scenes are called 'one'"),
        (["one", "--scene", "two"], "no method has a result of two"),
        (["good", "--scene", "one", "--mask", "m.png"], "--mask"),
        (["good", "--scene", "one", "--border", "40"], "good on one: border"),
    ],
)
def test_comparisons_that_cannot_be_made(
    arguments: list[str], words: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    refused(lfgpu("eval", *arguments), words)


def test_eval_wants_a_result_and_its_truth(folder: Path) -> None:
    for arguments in ([folder / "good"], [folder / "good", folder / "one", folder / "two"]):
        outcome = lfgpu("eval", *arguments)
        assert outcome.code == 2
        assert "Traceback" not in outcome.err


def test_one_result_is_not_taken_for_several_scenes(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "disparity.pfm").write_bytes((folder / "good" / "one.pfm").read_bytes())
    said("eval", tmp_path / "m", "--scene", folder / "one")
    outcome = lfgpu("eval", tmp_path / "m", "--scene", folder / "one", "--scene", folder / "two")
    refused(outcome, "no method has a result of one")


def test_error_maps_share_a_scale() -> None:
    truth = np.zeros((40, 50), np.float32)
    scene = Scene("a", np.zeros((40, 50, 3), np.float32), truth, {"x": truth + 0.05, "y": truth - 0.01})
    other = Scene("b", np.zeros((40, 50, 1), np.float32), truth, {"x": truth + 1.0})
    sheet = np.asarray(sheets.comparison([scene, other]))
    for error in (0.05, -0.01, 1.0):
        wanted = painted(np.full((1, 1), error, np.float32), LOOKS["error"].colours, (-0.07, 0.07))[0, 0]
        assert (sheet == wanted).all(axis=2).sum() > 8_000, error  # pixels inside the border, four times enlarged
    assert [row.best[0] for row in table([scene, other]).rows] == [False, True, True, False]
    with pytest.raises(LightFieldError, match="nothing to compare"):
        sheets.comparison([])
    with pytest.raises(LightFieldError, match="nothing to compare"):
        table([])


@pytest.mark.parametrize("shape", [(512, 512), (40, 50), (90, 40)])
def test_maps_in_a_comparison_are_not_stretched(shape: tuple[int, int]) -> None:
    truth = np.zeros(shape, np.float32)
    red = np.broadcast_to(np.float32([1, 0, 0]), (*shape, 3))
    sheet = np.asarray(sheets.comparison([Scene("a", red, truth, {"x": truth, "y": truth}, 0)]))
    rows, columns = np.nonzero((sheet == (255, 0, 0)).all(axis=2))
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(shape[1] / shape[0], rel=0.02)


# --- notebooks ---


def test_light_fields_and_results_show_themselves(lf: LightField) -> None:
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    views = ViewsResult(
        *(np.repeat(result.disparity[None], 9, axis=0), np.repeat(result.confidence[None], 9, axis=0)),
        *(lf.positions, (4,), result, {"total": 1.0}),
    )
    named = replace(result, name="<b>x")
    for thing, count in (
        (replace(lf, name="<b>x"), 3),
        (lf.subset([0, 4]), 1),
        (named, 3),
        (named.map, 3),
        (replace(named.map, confidence=None, uncertainty=None), 1),
        (replace(views, reference=named), 2),
    ):
        page = thing._repr_html_()
        links = Links()
        links.feed(page)
        assert "script" not in links.tags
        assert all(address.startswith("data:image/") for address in links.addresses)
        assert len(pictures(page)) == count
        assert "<b>x" not in page.replace("<b>&lt;b&gt;x", "")
    holes = np.full_like(result.disparity, np.nan)
    page = replace(result, disparity=holes)._repr_html_()
    assert all((picture == UNDEFINED).all() for picture in pictures(page)[:2])


@pytest.mark.parametrize("part", [np.s_[:1, :], np.s_[:, :1], np.s_[:2, :2]], ids=["row", "column", "four"])
def test_a_report_of_views_that_are_hardly_larger_than_a_pixel(part: tuple[slice, slice], tmp_path: Path) -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(48, 64), seed=3).crop(*part)
    result = estimate_depth(lf, config="fast", disparity_range=(-1, 1))
    write_report(tmp_path / "report.html", lf, result)
    assert reasons(lf, result).shape == lf.size


def test_a_report_of_another_view_or_size_is_refused(lf: LightField, tmp_path: Path) -> None:
    for other in (lf.with_reference(0), scenes.make("boxes", grid=(3, 3), size=(40, 56))):
        with pytest.raises(LightFieldError, match="the result is of 48 x 56 px"):
            write_report(tmp_path / "report.html", other, result_of(lf))
    assert not any(tmp_path.iterdir())
    write_report(tmp_path / "report.html", lf, result_of(lf))
    assert "written" not in (tmp_path / "report.html").read_text(encoding="utf-8")

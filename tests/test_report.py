"""The report, comparisons and notebooks: what stands in them is what was found, and nothing comes from elsewhere."""

from __future__ import annotations

import base64
import csv
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.comparison import Scene, table
from lfgpu.config import parameters
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.errors import LightFieldError
from lfgpu.io import read_result, write_hci, write_pfm
from lfgpu.methods import PRESETS
from lfgpu.metrics import evaluate
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.viz.figures import comparison_figure

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
        assert scene.truth is not None
        for method, error in (("good", 0.006), ("bad", 0.05)):
            (place / method).mkdir(exist_ok=True)
            write_pfm(place / method / f"{name}.pfm", scene.truth.disparity + error)
    return place


def run(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


class Links(HTMLParser):
    """What a page names: tags and addresses."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]


# --- the report ---


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_report_says_all_and_needs_no_network(preset: str, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    more = ["--set=refinement.max_iterations=3"] if preset == "paper" else []
    code, _, err = run("depth", folder / "one", "-o", out, "--preset", preset, RANGE, "--report", "-q", *more)
    assert (code, err) == (0, "")
    page = (out / "report.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert not links.tags & {"script", "link", "iframe", "object"}
    assert links.addresses
    assert all(address.startswith("data:image/") for address in links.addresses)
    assert "@import" not in page
    assert "url(" not in page
    assert "prefers-color-scheme: dark" in page
    for address in links.addresses:
        with Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))) as image:
            assert min(image.size) > 10
    result = read_result(out / "result.npz")
    for name, _ in parameters(result.config):
        assert f"<code>{name}</code>" in page
    for version in result.versions.values():
        assert version in page
    for stage in result.stages:
        assert f"<td>{stage}</td>" in page
    truth = scenes.make("boxes", grid=(3, 3), size=(48, 56)).truth
    assert truth is not None
    assert f"{evaluate(result.disparity, truth.disparity).mse_100:.3f}" in page
    assert ("polyline" in page) == (preset == "paper")
    assert ('refinement.max_iterations</code></td><td class="n changed">3' in page) == (preset == "paper")


def test_names_cannot_break_out_of_the_page(lf: LightField) -> None:
    from dataclasses import replace

    from lfgpu.cli.report import html

    named = replace(lf, name="<script>x</script>", truth=None, geometry=None)
    page = html(named, estimate_depth(named, config="fast", disparity_range=(-2, 2)))
    assert "<script>" not in page
    assert "Ground truth" not in page


@pytest.mark.parametrize(
    ("preset", "trace", "title", "unit", "first"),
    [
        ("accurate", (0.3, 0.2, 0.1), "Step of the alignment", "px per view step, rms", 1),
        ("paper", (30.0, 20.0, 10.0), "Energy of the refinement", "", 0),
        ("accurate", (0.3, 0.2, 0.001), "Step of the alignment", "px per view step, rms, logarithmic scale", 1),
    ],
)
def test_the_curve_is_of_what_the_method_traces(
    lf: LightField, preset: str, trace: tuple[float, ...], title: str, unit: str, first: int
) -> None:
    from lfgpu.cli.report import html

    assert lf.truth is not None
    maps = {"any": lf.truth.disparity}
    result = DepthResult(
        *(lf.truth.disparity, np.ones(lf.size, np.float32), maps, (1.0, 1.0), (-2.0, 2.0), PRESETS[preset]),
        *("It stopped.", True, trace, {"any": 1.0, "total": 1.0}, "warp", "cpu"),
    )
    page = html(lf, result)
    assert f"{title} <small>{unit}</small>" in page
    ticks = re.findall(r'<text x="[0-9.]+" y="208" text-anchor="middle">(\d+)</text>', page)
    assert ticks == [str(first + n) for n in range(3)]


def test_without_report_there_is_none(folder: Path, tmp_path: Path) -> None:
    assert run("depth", folder / "one", "-o", tmp_path / "out", "--preset=fast", RANGE, "-q")[0] == 0
    assert not (tmp_path / "out" / "report.html").exists()


# --- comparisons ---


def test_methods_are_compared_on_scenes(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "table"
    code, said, err = run(
        "eval", folder / "bad", folder / "good", "--scene", folder / "one", "--scene", folder / "two", "-o", out
    )
    assert (code, err) == (0, "")
    assert {file.name for file in out.iterdir()} == {"table.md", "table.tex", "table.csv", "errors.png"}
    with (out / "table.csv").open() as file:
        rows = {(row["scene"], row["metric"]): (float(row["bad"]), float(row["good"])) for row in csv.DictReader(file)}
    assert rows["one", "MSE x100"] == pytest.approx((0.25, 0.0036), rel=1e-3)
    assert rows["two", "BadPix 0.03"] == pytest.approx((100, 0))
    assert rows["average of 2", "Q25 x100"] == pytest.approx((5, 0.6), rel=1e-3)
    assert "| one | MSE x100 | 0.250 | **0.004** |" in (out / "table.md").read_text()
    assert r"\textbf{0.004}" in (out / "table.tex").read_text()
    assert "BadPix 0.07" in said


def test_a_method_without_a_map_leaves_a_gap(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "one.pfm").write_bytes((folder / "good" / "one.pfm").read_bytes())
    code, said, _ = run("eval", folder / "bad", tmp_path / "half", "--scene", folder / "one", "--scene", folder / "two")
    assert code == 0
    assert re.search(r"two +MSE x100 +0\.250 +-", said)


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
    code, _, err = run("eval", *arguments)
    assert code == 1
    assert words in err
    assert err.count("\n") == 1


def test_eval_wants_a_result_and_its_truth(folder: Path) -> None:
    for arguments in ([folder / "good"], [folder / "good", folder / "one", folder / "two"]):
        code, _, err = run("eval", *arguments)
        assert code == 2
        assert "Traceback" not in err


def test_one_result_is_not_taken_for_several_scenes(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "disparity.pfm").write_bytes((folder / "good" / "one.pfm").read_bytes())
    assert run("eval", tmp_path / "m", "--scene", folder / "one")[0] == 0
    code, _, err = run("eval", tmp_path / "m", "--scene", folder / "one", "--scene", folder / "two")
    assert code == 1
    assert "no method has a result of one" in err


def test_error_maps_share_a_scale() -> None:
    truth = np.zeros((40, 50), np.float32)
    scene = Scene("a", np.zeros((40, 50, 3), np.float32), truth, {"x": truth + 0.1, "y": truth - 0.01})
    other = Scene("b", np.zeros((40, 50, 1), np.float32), truth, {"x": truth + 1.0})
    figure = comparison_figure([scene, other])
    errors = [axes.images[0].get_clim() for axes in figure.axes if axes.get_xlabel().endswith(("0", "1"))]
    assert len(set(errors)) == 1
    assert any(axes.get_xlabel() == "no map" for axes in figure.axes)
    assert table([scene, other]).rows[0].best == 1
    with pytest.raises(LightFieldError, match="nothing to compare"):
        comparison_figure([])
    with pytest.raises(LightFieldError, match="nothing to compare"):
        table([])


# --- notebooks ---


def test_light_fields_and_results_show_themselves(lf: LightField) -> None:
    from dataclasses import replace

    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    for thing in (replace(lf, name="<b>x"), replace(result, name="<b>x"), lf.subset([0, 4])):
        page = thing._repr_html_()
        links = Links()
        links.feed(page)
        assert "script" not in links.tags
        assert all(address.startswith("data:image/png;base64,") for address in links.addresses)
        assert "<b>x" not in page.replace("<b>&lt;b&gt;x", "")
    holes = result.disparity.copy()
    holes[:] = np.nan
    assert "img" in replace(result, disparity=holes)._repr_html_()

"""The report in a browser and on paper: nothing is cut, everything is seen, in light and dark, wide and narrow."""

import io
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lfgpu import explain, scenes
from lfgpu.comparison import Scene, table
from lfgpu.data import LightField
from lfgpu.reports.comparison import write_comparison
from lfgpu.reports.report import Origin, write_report
from lfgpu.viz.cards import scale_of
from tests.made import made_result

SCREENS = {"wide": (1600, 1000), "laptop": (1366, 650), "phone": (390, 844)}
ON_ONE_PAGE = {
    "Ground truth": "disparity, px per view step",
    "Error": "too near",
    "Confidence": "larger is surer",
    "Uncertainty": "standard deviation",
    "Sparsification": "pixels kept",
    "Reliability": "share of all pixels",
    "Cameras": "PSNR, dB",
    "Prediction error": "share of full intensity",
    "Time of each stage": "sweep",
}
"""Titles of cards, and what stands at their lower ends."""


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("planes", grid=(3, 3), size=(96, 128))


@pytest.fixture(scope="module")
def report(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report with everything that one can have."""
    disparity = lf.truth.disparity + np.linspace(-0.2, 0.2, lf.size[1], dtype=np.float32)
    disparity[:10, :10] = np.nan
    result = made_result(
        disparity,
        0.9,
        stages={"sweep": disparity, "align": disparity},
        position=lf.truth.position,
        trace=(0.3, 0.1),
        timings={"compile": 3.0, "measure": 0.2, "sweep": 1.0, "align": 0.4, "total": 4.6},
        geometry=lf.geometry,
        name="A light field with a name that is far longer than any screen of a phone is wide",
        uncertainty=np.where(np.isnan(disparity), np.float32(np.nan), np.float32(0.1)),
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    origin = Origin("a/folder", f"lfgpu depth a/folder -o out {'--set alignment.iterations=2 ' * 8}", None, "A CPU")
    write_report(path, lf, result, origin=origin, explanation=explain(lf, disparity))
    return path


def opened(browser: Any, path: Path, screen: str = "wide", colours: str = "light") -> Any:
    width, height = SCREENS[screen]
    page = browser.new_context(viewport={"width": width, "height": height}, color_scheme=colours).new_page()
    page.goto(path.as_uri())
    return page


def shot(of: Any) -> np.ndarray:
    """Take a picture of a page or an element, [y, x, 3]."""
    with Image.open(io.BytesIO(of.screenshot())) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def luminance(colours: np.ndarray) -> np.ndarray:
    """Relative luminance as WCAG 2 defines it."""
    linear = np.where(colours <= 10, colours / 255 / 12.92, ((colours / 255 + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    darker, lighter = np.minimum(luminance(one), luminance(other)), np.maximum(luminance(one), luminance(other))
    return (lighter + 0.05) / (darker + 0.05)


def bars(picture: np.ndarray, stops: tuple[str, ...]) -> int:
    """Count the rows of a picture that hold the colours of a scale, from left to right."""
    columns, before = np.arange(picture.shape[1]), np.full(len(picture), -1)
    for stop in stops[1:-1]:
        colour = np.array([int(part) for part in stop[4:-1].split()])
        close = (np.abs(picture - colour) <= 6).all(axis=2) & (columns > before[:, None])
        there = close.any(axis=1)
        picture, before = picture[there], close[there].argmax(axis=1)
    return len(picture)


# --- on screens ---


@pytest.mark.parametrize(
    ("screen", "colours"), [("wide", "light"), ("laptop", "dark"), ("phone", "light"), ("phone", "dark")]
)
def test_everything_is_seen_on_every_screen(browser: Any, report: Path, screen: str, colours: str) -> None:
    page = opened(browser, report, screen, colours)
    width, _ = SCREENS[screen]
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "nothing is wider than the screen"
    wrong = "e => [...e.querySelectorAll('img')].filter(i => !i.complete || !i.naturalWidth).length"
    assert page.locator("body").evaluate(wrong) == 0
    for kind in (".tile", ".lf-card", "pre"):
        cut = f"[...document.querySelectorAll('{kind}')].filter(e => e.scrollWidth > e.clientWidth + 1).length"
        assert page.evaluate(cut) == 0, f"a {kind} is too narrow for what is in it"
    background = shot(page)[2, 2]
    assert (background < 40).all() if colours == "dark" else (background > 230).all()
    seen = "e => [getComputedStyle(e).color, getComputedStyle(document.documentElement).backgroundColor]"
    for text in (".lead", ".lf-note", "h2", "td", "th", "figcaption", ".lf-bar span", ".tile b", ".lf-chart text"):
        found = page.locator(text).first.evaluate(seen)
        ink, paper = (np.array([float(n) for n in colour[4:-1].split(",")]) for colour in found)
        assert contrast(ink, paper) > 4.5, text
    page.context.close()


@pytest.mark.parametrize("title", ["Disparity", "Reference view", "A: row"])
def test_a_click_enlarges_a_picture_with_its_scale(browser: Any, report: Path, title: str) -> None:
    page = opened(browser, report)
    card = page.locator("figure", has=page.locator("figcaption", has_text=title)).first
    picture = card.locator(".lf-picture")
    before = picture.bounding_box()["width"]
    card.locator(".lf-zoom").click()
    assert card.bounding_box() == {"x": 0, "y": 0, "width": 1600, "height": 1000}
    assert picture.bounding_box()["width"] > 1.5 * before
    assert card.locator("figcaption").is_visible()
    if title == "Disparity":
        foot = card.locator(".lf-note").bounding_box()
        assert foot["y"] + foot["height"] <= 1000, "the unit is on the screen"
        assert len(np.unique(shot(picture)[:, 500:1100].reshape(-1, 3), axis=0)) < 400, "pixels stay sharp squares"
    page.keyboard.press("Space")
    assert picture.bounding_box()["width"] == before
    page.context.close()


@pytest.mark.parametrize(("screen", "columns"), [("wide", 4), ("phone", 1)])
def test_methods_stand_side_by_side(browser: Any, lf: LightField, tmp_path: Path, screen: str, columns: int) -> None:
    truth = lf.truth.disparity
    maps = {f"method {n}": truth + np.float32(0.02 * n) for n in range(3)}
    scene = Scene("a scene", lf.image(lf.reference_index), truth, maps)
    write_comparison(tmp_path / "report.html", [scene], table([scene]))
    page = opened(browser, tmp_path / "report.html", screen)
    width, _ = SCREENS[screen]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = [card.bounding_box() for card in page.locator(".lf-card").all()]
    assert len(boxes) == 2 * 4
    assert len({round(box["x"]) for box in boxes}) == columns
    assert all(box["x"] + box["width"] <= width for box in boxes)
    page.context.close()


# --- on paper ---


@pytest.fixture(scope="module")
def pdf(browser: Any, report: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report, printed for somebody who likes it dark, as a browser does by itself: without backgrounds."""
    if shutil.which("pdftoppm") is None:
        pytest.skip("there is no pdftoppm here to look at a PDF: apt-get install poppler-utils")
    page = opened(browser, report, colours="dark")
    path = tmp_path_factory.mktemp("pdf") / "report.pdf"
    page.pdf(path=path, format="A4", print_background=False)
    page.context.close()
    return path


def printed(pdf: Path) -> list[np.ndarray]:
    """The pages at 96 pixels per inch, [y, x, 3]."""
    subprocess.run(["pdftoppm", "-r", "96", "-png", pdf, pdf.with_suffix("")], check=True)
    found = []
    for path in sorted(pdf.parent.glob("*.png")):
        with Image.open(path) as image:
            found.append(np.asarray(image.convert("RGB")).astype(np.int16))
    return found


def texts(pdf: Path) -> list[str]:
    """The words of each page."""
    done = subprocess.run(["pdftotext", "-raw", pdf, "-"], check=True, capture_output=True, text=True)
    return [" ".join(page.split()) for page in done.stdout.split("\f")[:-1]]


def test_a_printed_report_is_complete(pdf: Path) -> None:
    pages, words = printed(pdf), texts(pdf)
    assert len(pages) == len(words) > 1
    for number, page in enumerate(pages, 1):
        assert (page < 200).all(axis=2).mean() > 0.002, f"page {number} is blank"
        assert (page[:20] == 255).all(), "paper is white"
    for kind in ("disparity", "confidence", "unexplained"):
        stops = scale_of(kind, np.zeros((2, 2), np.float32), (0, 1)).stops
        assert sum(bars(page, stops) for page in pages) >= 6, f"the scale of {kind} is not printed"
    assert any("All parameters" in page and "sweep.noise" in page for page in words), "parted from its heading"
    for title, foot in ON_ONE_PAGE.items():
        assert any(title in page and foot in page for page in words), f"the card {title} is cut"
    assert "sweep.noise" in " ".join(words), "parameters are printed although they are folded on the screen"
    assert not any(page.endswith(("Input", "Computation", "Epipolar plane images")) for page in words)

"""What the page says of what may be wrong, keys that always work, and a surface in its own colours."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lfgpu.cli import app
from lfgpu.data import DisparityMap, LightField
from lfgpu.io import load, write_pfm
from lfgpu.viewer import Viewer
from lfgpu.viewer.facts import Facts
from lfgpu.viewer.solving import Progress
from tests.browser import until
from tests.viewer.page import Page


def test_findings_stand_above_everything(browser: Any, lf: LightField, files: Path) -> None:
    doubted = replace(lf, notes=("Dark corners of the lenslets are masked.",))
    with Viewer(doubted, port=0) as viewer, Page(browser, viewer) as page:
        page.says("1 finding", "#findings summary")
        assert "Dark corners" in page.tab.inner_text("#findings li")
        result = load(files / "fast")
        cameras = "Cameras are out of line by 0.4 px (rms along each axis): line them up with `lfgpu rectify --refine`."
        viewer.add(replace(result, disparity=result.disparity + 0.5, remarks=(cameras,), notes=("A range is small.",)))
        page.says("4 findings", "#findings summary")
        said = page.tab.inner_text("#findings")
        assert "A range is small." in said
        assert "100 % of the map is more than 0.07 px off the ground truth" in said
        assert page.tab.inner_text("#findings code") == "lfgpu rectify --refine"
        box = page.tab.locator("#findings").bounding_box()
        assert box["y"] + box["height"] <= page.tab.locator("#map").bounding_box()["y"]
        page.choose("result", "ground truth")
        page.says("1 finding", "#findings summary")
        page.tab.mouse.move(*page.spot("map", 20, 20))
        page.reads("of the ground truth")


def test_what_iterations_left_and_what_was_read_is_said(lf: LightField, files: Path) -> None:
    with Viewer(lf, replace(load(files / "fast"), converged=False), port=0) as viewer:
        now = Facts(viewer).now()
        assert "Not converged" in now["results"][0]["about"]
        assert now["lightField"]["read"] == [f"{a.capitalize()}: {b}." for a, b in lf.reading.lines()]
        unsure = DisparityMap(np.zeros(lf.size, np.float32), np.full(lf.size, 0.2, np.float32))
        viewer.show(replace(lf, truth=None), unsure)
        assert Facts(viewer).now()["results"][0]["findings"] == ["The confidence is below 0.5 at 100 % of the map."]


def test_keys_work_after_menus_sliders_checkboxes_and_3d(page: Page) -> None:
    there = itertools.cycle(("ArrowRight", "ArrowLeft"))

    def is_next_view() -> None:
        before = page.tab.inner_text("#left-title")
        page.tab.keyboard.press(next(there))
        until(lambda: page.tab.inner_text("#left-title") != before, "the next view is shown", page.tab)

    page.tab.click("#quantity")
    page.choose("quantity", "confidence")
    is_next_view()
    page.tab.evaluate("document.querySelectorAll('aside details').forEach(one => one.open = true)")
    for name in ("gamma", "find-range"):
        page.tab.click(f"#{name}")
        is_next_view()
    page.tab.keyboard.press("d")
    page.has_points()
    page.tab.click("#space-frame iframe", position={"x": 5, "y": 5})
    until(lambda: page.tab.evaluate("document.activeElement.tagName") == "IFRAME", "3D has the keys", page.tab)
    is_next_view()
    page.tab.keyboard.press("m")
    until(lambda: page.tab.locator("#map").is_visible(), "the map is shown", page.tab)
    page.tab.click("#as-stored")
    page.tab.check("#find-range")


def test_the_surface_has_the_colours_of_the_picture(browser: Any, lf: LightField) -> None:
    """One colour, in which light, a wrong space of colours or a fade would show; without a map there is a word."""
    one = replace(lf, views=np.broadcast_to(np.array([60, 110, 200], np.uint8), lf.views.shape).copy(), truth=None)
    least = """window.least = 1;
    (function look() {
        const isSeen = !frameElement || getComputedStyle(frameElement).visibility === "visible";
        const opacities = [...document.querySelectorAll("canvas")].map((one) => getComputedStyle(one).opacity);
        if (isSeen) least = Math.min(least, ...opacities);
        requestAnimationFrame(look);
    })();"""
    with Viewer(one, port=0) as viewer, Page(browser, viewer, script=least) as page:
        page.shown("view", "view")
        page.tab.keyboard.press("d")
        page.says("No map yet: press Estimate.", "#space-note")
        ramp = np.broadcast_to(np.linspace(-1, 1, lf.size[1], dtype=np.float32), lf.size)
        viewer.add(DisparityMap(ramp.copy()))
        page.has_points()

        def shares() -> tuple[float, float] | None:
            seen = page.space()
            drawn = (np.abs(seen - 255).max(axis=2) > 40) & ~((seen[..., 0] > 180) & (seen[..., 1] < 120))
            right = np.abs(seen - (60, 110, 200)).max(axis=2) <= 3
            share = float(drawn.mean())
            return (share, float((drawn & right).sum() / drawn.sum())) if share > 0.1 else None

        for mesh in ("", "1"):
            page.choose("space-mesh", mesh)
            share, right = until(shares, f"something is seen of {mesh!r}", page.tab)
            assert right > 0.8, f"from the first picture on; {share:.0%} of the frame is drawn"
        assert [frame.evaluate("least") for frame in page.tab.frames] == [1, 1], "nothing is pale at first"


def test_an_estimate_says_how_far_it_is_at_every_size(page: Page, viewer: Viewer) -> None:
    for width, height in ((1600, 1000), (1366, 650)):
        page.tab.set_viewport_size({"width": width, "height": height})
        viewer.solver.progress = Progress("alignment, iteration 3, 1.5 s", 40, True)
        viewer.tell()
        page.tab.wait_for_selector("#stop", state="visible")
        box = page.tab.locator("#stop").bounding_box()
        assert box["y"] + box["height"] < 60
        assert box["x"] + box["width"] < width
        assert "iteration 3" in page.tab.inner_text("#progress-text")
        viewer.solver.progress = Progress()
        viewer.tell()
        page.tab.wait_for_selector("#stop", state="hidden")


def test_scales_of_a_stream_do_not_jitter(lf: LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.viewer.facts._SCALE_AGE", 0.0)
    with Viewer(replace(lf, truth=None), port=0) as viewer:
        facts = Facts(viewer)
        ends = []
        for reach in (1.0, 3.0, 0.5):
            viewer.update(np.linspace(-reach, reach, lf.size[0] * lf.size[1]).reshape(lf.size), views=lf.views)
            ends.append(facts.now()["scales"]["disparity"]["limits"])
        assert ends[0][1] < ends[1][1] == ends[2][1]


def test_a_resting_pointer_and_the_chosen_pixel_say_the_frame_that_is_shown(browser: Any, lf: LightField) -> None:
    with Viewer(replace(lf, truth=None), port=0) as viewer:
        viewer.update(np.full(lf.size, 1.0), views=lf.views)
        page = Page(browser, viewer)
        page.shown("map", "disparity")
        page.tab.mouse.move(*page.spot("map", 30, 20))
        page.reads("disparity 1.000")
        viewer.update(np.full(lf.size, 2.0), views=lf.views)
        page.reads("disparity 2.000")
        page.tab.mouse.move(5, 5)
        page.reads("disparity 2.000")
        page.close()


def test_cameras_around_zero_are_no_rows_and_columns(browser: Any, lf: LightField) -> None:
    shifted = replace(lf, positions=lf.offsets * 1.01, truth=None, grid_shape=None)
    assert "count from the camera at 0, 0" in repr(shifted)
    assert "count from" not in repr(lf)
    with Viewer(shifted, port=0) as viewer, Page(browser, viewer) as page:
        page.shown("view", "view")
        assert page.tab.inner_text("#left-title") == f"View {lf.reference_index}, reference"


def test_without_what_the_viewer_needs_no_address_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    write_pfm(tmp_path / "map.pfm", np.zeros((5, 6)))
    said = CliRunner().invoke(app, ["view", str(tmp_path / "map.pfm"), "--port", "0"])
    assert said.exit_code == 1
    assert said.stdout == ""
    assert "pip install 'lfgpu[viewer]'" in said.stderr

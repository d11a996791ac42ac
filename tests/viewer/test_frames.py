"""Streams and films on the page: what is shown belongs to one frame."""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.live_maps import fingerprint, write_live_map
from lfgpu.pipelines.sources.recording import recorded
from lfgpu.viewer import Viewer
from tests.browser import until
from tests.stream_runs import pushing
from tests.viewer.page import SIZE, Page


def test_a_stream_is_followed_without_scores_of_another_frame(browser: Any, lf: LightField, files: Path) -> None:
    switched: list[bool] = []
    with Viewer.of([files / "boxes"], port=0) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")
        viewer.offer(pause=switched.append)
        told = {"rate": 12.5, "latency": 0.04, "dropped": 3}
        viewer.update(lf.truth.disparity - 0.2, np.full(lf.size, 0.5), views=lf.views[::-1].copy(), **told)
        until(lambda: page.tab.input_value("#result") == "live", "the stream is shown", page.tab)
        live = page.key("map")
        page.says("12.5 frames/s · 40 ms latency · 3 dropped", "#stream")
        assert not page.tab.locator("#scores").is_visible()
        assert "error" not in page.readout()
        page.shown("view", "view")
        assert page.at("view", 4, 30) == tuple(lf.views[::-1][lf.reference_index, 30, 4])
        viewer.update(np.zeros(lf.size))
        page.shown("map", "disparity", before=live)
        # Frames that come faster than pictures are left out, but pictures come.
        with pushing(lambda: viewer.update(lf.truth.disparity, views=lf.views), 0.01):
            for _ in range(3):
                page.shown("map", "disparity", before=page.key("map"))
        page.tab.click("#pause")
        until(lambda: switched == [True], "the stream is paused", page.tab)
        page.says("paused", "#stream")
        viewer.close()
        until(lambda: page.tab.locator("#gone").is_visible(), "the page says that the viewer has gone", page.tab)


def test_all_tiles_are_of_one_frame(browser: Any) -> None:
    """Frames of one colour each, which come faster than tiles: no picture that is drawn has two colours."""
    views = np.zeros((2, 1100, 1500, 1), np.uint8)
    lf = LightField(views, [[0, 0], [1, 0]], name="film")
    with Viewer(lf, port=0) as viewer, Page(browser, viewer) as page:
        page.shown("view", "view")
        page.enlarge("view", 700, 550, 3)
        page.moved("view", lambda place: place[2] >= 1, "the view is enlarged")
        shades = itertools.cycle(range(5, 255, 5))

        def push() -> None:
            shade = next(shades)
            viewer.update(np.full((1100, 1500), shade, np.float32), views=np.full_like(views, shade))

        code = """() => {
            const canvas = document.getElementById("view"), map = document.getElementById("map");
            if (!canvas.dataset.drawn) return null;
            const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height), found = {};
            for (let k = 0; k < data.length; k += 4) {
                const key = `${data[k]},${data[k + 1]},${data[k + 2]}`;
                if (data[k + 3] === 255) found[key] = (found[key] ?? 0) + 1;
            }
            return [canvas.dataset.drawn, found, canvas.width * canvas.height];
        }"""
        with pushing(push, 0.02):
            seen: set[str] = set()
            while len(seen) < 6:
                answer = page.tab.evaluate(code)
                if answer is None or answer[0] in seen:
                    page.tab.wait_for_timeout(10)
                    continue
                key, found, count = answer
                seen.add(key)
                large = [colour for colour, times in found.items() if times > 0.04 * count]
                assert len(large) == 1, (key, found)  # the marks are small


def test_a_film_is_looked_at_frame_by_frame(browser: Any, lf: LightField, tmp_path: Path) -> None:
    frames = [replace(lf, views=np.full_like(lf.views, shade), truth=None) for shade in (40, 90, 160)]
    for _ in recorded(iter(frames), lf, tmp_path / "film"):
        pass
    log = [{"frame": n, "reference": fingerprint(frame.views[lf.reference_index])} for n, frame in enumerate(frames)]
    log[1]["error"] = "this frame was dropped"
    for number in (0, 2):
        write_live_map(tmp_path / "maps", number, np.full(SIZE, number + 1, np.float32), np.ones(SIZE, np.float32))
    (tmp_path / "maps" / "live.json").write_text(json.dumps({"frames": log}))
    with Viewer.of([tmp_path / "maps", tmp_path / "film"], port=0) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")

        def shows(number: int) -> None:
            page.says(f"Frame {number + 1} of 3", "#film-text")
            shade = (40, 90, 160)[number]
            until(lambda: page.at("view", 3, 3) == (shade, shade, shade), f"frame {number} is shown", page.tab)

        page.tab.evaluate("document.getElementById('as-stored').click()")  # dark ones are shown brighter
        shows(0)
        page.tab.keyboard.press(".")
        shows(1)
        until(lambda: page.tab.locator("#map-note").is_visible(), "there is no map of this frame", page.tab)
        page.tab.click("#following")
        shows(2)
        page.reads("disparity 3.000")
        page.tab.keyboard.press(",")
        page.tab.keyboard.press(",")
        shows(0)
        page.reads("disparity 1.000")
        page.tab.click("#play")
        shows(2)
        page.tab.click("#play")
        with pytest.raises(LightFieldError, match="has no frame 3"):
            viewer.turn(3)
        (tmp_path / "film" / "frame_000001" / "views.npz").unlink()
        with pytest.raises(LightFieldError, match="frame_000001"):
            viewer.turn(1)
    with pytest.raises(LightFieldError, match="give the folder of the recorded frames, too"):
        Viewer.of([tmp_path / "maps"], port=0)

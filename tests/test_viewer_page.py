"""The page of the viewer in a browser: what is seen changes with what is asked for, in every tab on its own."""

from __future__ import annotations

import io
import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image

from lfgpu import scenes
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci, write_result
from lfgpu.pipelines.estimate import estimate_depth
from tests.browser import chromium, pixels, until

pytest.importorskip("viser", reason="viser is not installed: pip install -e '.[viewer]'")

from lfgpu.viewer import Viewer

PICTURES = 'img[src^="blob:"]'  # others are icons


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(40, 48))


@pytest.fixture(scope="module")
def files(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field and a result of it."""
    folder = tmp_path_factory.mktemp("shown")
    write_hci(lf, folder / "boxes")
    (folder / "fast").mkdir()
    write_result(estimate_depth(lf, config="fast", disparity_range=(-2, 2)), folder / "fast" / "result.npz")
    return folder


@pytest.fixture(scope="module")
def viewer(files: Path) -> Iterator[Viewer]:
    with Viewer.of([files / "fast", files / "boxes"], port=0, allow_open=True) as opened:
        yield opened


class Page:
    """One tab that shows the viewer."""

    def __init__(self, browser: Any, viewer: Viewer) -> None:
        self.tab = browser.new_context(viewport={"width": 1250, "height": 640}).new_page()
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(viewer.url)
        self.tab.set_default_timeout(90_000)
        until(lambda: self.tab.locator(PICTURES).count() >= 2, "pictures are on the page", self.tab)
        self.settled()

    def picture(self, index: int) -> np.ndarray:
        """0: views and EPIs, -1: the map."""
        return pixels(self.tab.locator(PICTURES).nth(index))

    def settled(self) -> None:
        """Wait until the map has a colour bar: it is drawn and not only announced."""
        until(lambda: len(np.unique(self.picture(-1).reshape(-1, 3), axis=0)) > 500, "the map is drawn", self.tab)
        until(lambda: len(np.unique(self.picture(0).reshape(-1, 3), axis=0)) > 500, "the view is drawn", self.tab)

    def set(self, label: str, value: object) -> None:
        """Type a number beside a slider, or a text."""
        row = self.tab.get_by_text(label, exact=True).locator("xpath=ancestor::*[.//input][1]")
        box = row.locator("input:visible").last
        box.fill(str(value))
        box.press("Enter")
        box.blur()

    def choose(self, label: str, option: str) -> None:
        row = self.tab.get_by_text(label, exact=True).locator("xpath=ancestor::*[.//input][1]")
        row.locator("input:visible").last.click()
        self.tab.get_by_role("option", name=option, exact=True).click()

    def changed(self, index: int, before: np.ndarray, what: str) -> np.ndarray:
        def differs() -> list[np.ndarray]:
            now = self.picture(index)
            return [now] if now.shape != before.shape or (now != before).any() else []

        return until(differs, what, self.tab)[0]


@pytest.fixture(scope="module")
def shared(browser: Any, viewer: Viewer) -> Iterator[Page]:
    opened = Page(browser, viewer)
    yield opened
    assert not opened.errors
    opened.tab.context.close()


@pytest.fixture
def page(shared: Page) -> Page:
    """The tab that the tests share, for a page takes long to come; what they change, they set anew."""
    shared.tab.get_by_role("tab", name="Look").click()
    return shared


def test_sliders_change_the_view_and_the_slope(page: Page) -> None:
    before = page.picture(0)
    page.set("View column", 0)
    other = page.changed(0, before, "another view is shown")
    assert np.abs(other.astype(int) - before).mean() > 1
    page.set("y", 5)
    page.changed(0, other, "the EPI of another row is shown")
    assert page.tab.get_by_text("du -2, dv 0 from the reference").is_visible()


def test_maps_are_compared_and_scored(page: Page) -> None:
    assert page.tab.get_by_text("MSE×100").is_visible()
    disparity = page.picture(-1)
    page.choose("Show", "error")
    error = page.changed(-1, disparity, "the error is shown")
    page.choose("Show", "disparity")
    page.choose("Beside", "ground truth")
    both = page.changed(-1, error, "two maps are shown")
    page.set("Wipe", 90)
    page.changed(-1, both, "the wipe line moved")


def test_points_are_drawn(page: Page) -> None:
    def coloured() -> bool:
        with Image.open(io.BytesIO(page.tab.screenshot(timeout=90_000))) as shot:
            middle = np.asarray(shot.convert("RGB"))[150:-50, 600:850]  # between the panels
        return len(np.unique(middle.reshape(-1, 3), axis=0)) > 1000

    until(coloured, "points are on the canvas", page.tab)


def test_it_is_estimated_again(page: Page, viewer: Viewer) -> None:
    before = page.picture(-1)
    page.tab.get_by_role("tab", name="Estimate").click()
    page.choose("Preset", "fast")
    page.tab.get_by_role("button", name="Estimate", exact=True).click()
    until(lambda: "fast 2" in viewer.contents.entries, "there is a second result", page.tab)
    page.tab.get_by_text("done in").wait_for()
    page.changed(-1, before, "the second result is shown beside the first")
    assert viewer.contents.entries["fast 2"].result is not None


def test_what_cannot_be_opened_or_set_is_said(page: Page) -> None:
    page.tab.get_by_role("tab", name="Files").click()
    page.set("Path", "/no/such/place")
    page.tab.get_by_role("button", name="Open", exact=True).click()
    page.tab.get_by_text("/no/such/place does not exist").wait_for()
    page.tab.get_by_role("tab", name="Estimate").click()
    page.set("Value", "many")
    page.tab.get_by_role("button", name="Change it").click()
    page.tab.get_by_text("must be a number").wait_for()


def test_each_tab_has_its_own_sliders(browser: Any, page: Page, viewer: Viewer) -> None:
    other = Page(browser, viewer)
    here, there = page.picture(0), other.picture(0)
    page.set("View row", 0)
    page.changed(0, here, "the view of this tab changes")
    np.testing.assert_array_equal(other.picture(0), there)
    other.tab.context.close()


def test_a_stream_is_followed(page: Page, viewer: Viewer, lf: LightField) -> None:
    before = page.picture(-1)
    assert lf.truth is not None
    for shift in (0.1, 0.2, 0.3):
        viewer.update(lf.truth.disparity - shift, np.full(lf.size, 0.5))
    live = page.changed(-1, before, "the live map is shown")
    viewer.update(np.zeros(lf.size))
    page.changed(-1, live, "the next one is shown")


def test_nothing_is_reached_from_elsewhere(viewer: Viewer) -> None:
    port = urlsplit(viewer.url).port
    assert port is not None
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)} - {"127.0.0.1"}
    for address in {*others, "127.0.0.2"}:
        with socket.socket() as probe:
            probe.settimeout(2)
            assert probe.connect_ex((address, port)) != 0, address
    with socket.create_connection(("127.0.0.1", port), 2):
        pass


@pytest.mark.parametrize(("origin", "answer"), [("http://evil.example", "403"), (None, "101")])
def test_pages_of_other_sites_are_refused(viewer: Viewer, origin: str | None, answer: str) -> None:
    found = urlsplit(viewer.url)
    own = f"http://{found.netloc}"
    lines = [
        f"GET {found.path} HTTP/1.1", f"Host: {found.netloc}", f"Origin: {origin or own}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: viser-v1.1.1",
    ]  # fmt: skip
    with socket.create_connection(("127.0.0.1", found.port), 5) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        assert connection.recv(200).decode().split()[1] == answer


@pytest.mark.parametrize("path", ["/", "/index.html", "/x/", "/?token=x", "/x/index.html"])
def test_nobody_without_the_token_is_answered(viewer: Viewer, path: str) -> None:
    with pytest.raises(HTTPError, match="403"):
        urlopen(f"http://{urlsplit(viewer.url).netloc}{path}", timeout=10)
    with urlopen(viewer.url, timeout=10) as answer:
        assert b"<html" in answer.read()


_PAYLOAD = '<img src=x onerror="window.owned = 1"><script>window.owned = 2</script>'


def test_text_from_files_does_not_become_part_of_the_page(browser: Any, lf: LightField, tmp_path: Path) -> None:
    """A result with a script in its status, in a folder with a script in its name, which also names a local file."""
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    folder = tmp_path / f"{_PAYLOAD.replace('/', '.')} ![a]({str(secret).replace('/', '|')})"
    folder.mkdir()
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    hostile = replace(result, status=f"{_PAYLOAD} ![a]({secret}) **b** {{7*7}}", device=_PAYLOAD, backend=_PAYLOAD)
    write_result(hostile, folder / "result.npz")
    write_hci(lf, tmp_path / "boxes")
    with Viewer.of([tmp_path / "boxes", folder], port=0) as viewer:
        page = Page(browser, viewer)
        page.tab.get_by_text("![a](", exact=False).first.wait_for()
        page.tab.get_by_text(f"{_PAYLOAD} ![a]({secret}) **b** {{7*7}}", exact=False).wait_for()
        page.tab.wait_for_timeout(500)  # for what would be run
        assert page.tab.evaluate("window.owned") is None
        assert page.tab.locator("img[src=x]").count() == 0
        page.tab.context.close()


def test_pages_open_only_what_was_given(browser: Any, files: Path, lf: LightField, tmp_path: Path) -> None:
    write_hci(lf, tmp_path / "other")
    (tmp_path / "link").symlink_to(files / "fast")
    with Viewer.of([files / "boxes"], port=0) as viewer:
        for path in (tmp_path / "other", files / "fast", files / "boxes" / ".." / "fast", tmp_path / "link", "/"):
            with pytest.raises(LightFieldError, match="--allow-open"):
                viewer.open_from_page(path)
        viewer.open_from_page(files / "boxes")
        viewer.open(files / "fast")  # its owner may


def test_nonsense_from_a_page_leaves_the_others_alone(
    page: Page, viewer: Viewer, capfd: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    from websockets.sync.client import connect

    address = viewer.url.replace("http://", "ws://")
    for data in (b"", b"\xff" * 100, b"\x80", rng.bytes(1000), "text", b"\x92" * 100_000):
        with connect(address, subprotocols=["viser-v1.1.1"]) as connection:
            connection.send(data)
            with suppress(Exception):
                connection.recv(timeout=0.5)
    assert "Traceback" not in capfd.readouterr().err
    before = page.picture(0)
    page.set("View row", 1)
    page.changed(0, before, "the view still follows its slider")

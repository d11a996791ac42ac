"""A browser for tests: headless Chromium, where there is one."""

import io
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

import numpy as np
import pytest
from PIL import Image

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser; the test is skipped, with a word, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = os.environ.get("LFGPU_CHROMIUM") or next(filter(None, map(shutil.which, _NAMES)), None)
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=found, args=_OPTIONS)
        except playwright.Error as error:
            pytest.skip(f"there is no Chromium here (apt-get install chromium): {str(error).splitlines()[0]}")
        yield browser
        browser.close()


def until(condition: Callable[[], Any], what: str, page: Any, seconds: float = 90) -> Any:
    """Wait for something to be true, and return it."""
    end = monotonic() + seconds
    while monotonic() < end:
        if result := condition():
            return result
        page.wait_for_timeout(50)
    pytest.fail(f"in {seconds:g} s this did not happen: {what}")


# A page that shows a new picture drops the old one, which can be between looking at its address and fetching it.
_FETCH = """async image => {
    for (let tries = 1; ; tries++) {
        try { return Array.from(new Uint8Array(await (await fetch(image.src)).arrayBuffer())); }
        catch (error) { if (tries === 40) throw error; }
        await new Promise(done => setTimeout(done, 50));
    }
}"""


def pixels(element: Any) -> np.ndarray:
    """Return the pixels of an <img>, [y, x, 3], as its file has them."""
    with Image.open(io.BytesIO(bytes(element.evaluate(_FETCH)))) as image:
        return np.asarray(image.convert("RGB"))

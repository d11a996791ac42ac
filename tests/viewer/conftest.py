"""One viewer and one tab for all tests of the page: each takes long to come."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.data import LightField
from lfgpu.io import save, write_hci
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.viewer import Viewer
from tests.viewer.page import HOLE, SIZE, Page


@pytest.fixture(scope="module", autouse=True)
def extra() -> None:
    """Tests are skipped where what the viewer needs is not installed."""
    for name in ("viser", "tornado"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install -e '.[viewer]'")


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=SIZE)


@pytest.fixture(scope="module")
def files(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field and a result of it with a hole."""
    folder = tmp_path_factory.mktemp("shown")
    write_hci(lf, folder / "boxes")
    (folder / "fast").mkdir()
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    disparity = result.disparity.copy()
    disparity[HOLE[0] : HOLE[1], HOLE[2] : HOLE[3]] = np.nan
    save(replace(result, disparity=disparity), folder / "fast" / "result.npz")
    return folder


@pytest.fixture(scope="module")
def viewer(files: Path) -> Iterator[Viewer]:
    with Viewer.of([files / "fast", files / "boxes"], port=0, allow_open=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def shared(browser: Any, viewer: Viewer) -> Iterator[Page]:
    opened = Page(browser, viewer)
    opened.shown("map", "disparity")
    opened.shown("view", "view")
    yield opened
    opened.close()


@pytest.fixture
def page(shared: Page) -> Page:
    """The tab that the tests share, for a page takes long to come; it is set back before each."""
    shared.back()
    return shared

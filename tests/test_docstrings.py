"""Examples in the docstrings of public functions and classes run, and every function of the reference has some."""

import doctest
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu.cli import app

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "api.md"
NAMES = re.findall(r"^   ((?:\w+\.)*\w+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
RETURNED = {
    "BackendError", "BackendInfo", "Config", "DepthResult", "DisparityMap", "Explanation", "FrameDroppedError",
    "LfgpuError", "LightFieldError", "PointCloud", "Rectifier", "RenderedView", "StreamResult", "ViewsResult",
    "calibration.Calibration", "calibration.Camera", "calibration.CameraInfo", "calibration.Rectified",
    "calibration.Refinement", "calibration.RigWatch", "metrics.Metrics", "metrics.Sparsification",
}  # fmt: skip
"""Classes that functions return or raise, in whose examples they are, and one that waits for cameras to move."""


def named(name: str) -> Any:
    found: Any = lfgpu
    for part in name.split("."):
        found = getattr(found, part) if hasattr(found, part) else __import__(f"lfgpu.{part}", fromlist=[part])
    return found


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Names that the page of the reference gives to all examples."""
    lf = lfgpu.scenes.make("boxes", grid=(5, 5), size=(64, 80))  # type: ignore[attr-defined]
    rig = tmp_path_factory.mktemp("examples") / "rig"
    scene = f"scene boxes -o {rig} --grid 5x5 --size 64x80 --misalign shift=0.5"
    assert CliRunner().invoke(app, scene.split()).exit_code == 0
    yield {"lfgpu": lfgpu, "np": np, "Path": Path, "lf": lf, "result": lfgpu.estimate_depth(lf), "rig": rig}
    lfgpu.set_threads(None)


def test_the_page_says_what_examples_have() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert 'lf = lfgpu.scenes.make("boxes", grid=(5, 5), size=(64, 80))' in text
    assert "lfgpu scene boxes -o rig --grid 5x5 --size 64x80 --misalign shift=0.5" in text


@pytest.mark.parametrize("name", NAMES)
def test_examples_run(name: str, given: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = inspect.getdoc(named(name)) or ""
    assert (">>> " in text) != (name in RETURNED), "an example, or an entry above"
    (tmp_path / "rig").symlink_to(given["rig"])
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(text, dict(given), name, None, None)
    said: list[str] = []
    doctest.DocTestRunner().run(example, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", NAMES)
def test_types_stand_in_the_words_of_the_source(name: str) -> None:
    """Types in the reference are texts: modules of what it shows have `from __future__ import annotations`."""
    found = named(name)
    members = [found, *vars(found).values()] if inspect.isclass(found) else [found]
    own = [
        getattr(m, "__init__", m) if inspect.isclass(m) else m for m in members if "Parameters\n" in (m.__doc__ or "")
    ]
    types = [text for member in own for text in getattr(member, "__annotations__", {}).values()]
    assert all(isinstance(text, str | None) for text in types)

"""The benchmark of the viewer's pictures asks for all of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.cases import parse
from benchmarks.cli import app
from benchmarks.viewer import made, pictures
from lfgpu.viewer.answers import DATA

pytestmark = pytest.mark.thorough


def test_all_kinds_of_pictures_are_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "viewer.json"
    outcome = CliRunner().invoke(app, ["viewer", "--case=3x3x48x64", "--times=1", "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    found = json.loads(out.read_text())
    assert found["case"] == "3x3x48x64"
    rows = {row["picture"]: row for row in found["pictures"]}
    assert {"view", "map", "refocused", "all in focus", "thumbnails", "EPI of a row"} <= rows.keys()
    assert rows["view"]["bytes"] == 48 * 64 * 3
    assert all(row["first_cpu"] >= 0 and row["first_wall"] >= 0 for row in rows.values())
    assert set(found) >= {"machine", "versions", "commit"}
    lf = made(parse("3x3x48x64")).lf
    assert lf is not None
    assert DATA.keys() - {"fixed"} == {picture.what for picture in pictures(lf)}

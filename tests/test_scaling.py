"""`python -m benchmarks scaling`: what it counts, with the CPU in the place of several GPUs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import scaling
from benchmarks.cases import CASES
from benchmarks.errors import BenchmarkError


@pytest.mark.parametrize(("kind", "counts"), [("processes", (2,)), ("threads", (1, 2))])
def test_every_mode_and_count_is_measured(kind: str, counts: tuple[int, ...], tmp_path: Path) -> None:
    plan = scaling.Plan(CASES[:1], ("fast",), ("cpu", "cpu"), counts, kind, 0.1)
    rows = scaling.run(plan, lambda _: None)
    assert [(row.mode, row.devices) for row in rows] == [(m, n) for m in scaling.MODES for n in counts]
    for row in rows:
        assert row.rate > 0
        assert row.milliseconds > 0
        assert row.efficiency == 1 or row.devices > 1
    assert scaling.table(rows).count("\n") == 2 + len(rows)
    scaling.save(rows, tmp_path / "scaling.json")
    assert len(json.loads((tmp_path / "scaling.json").read_text())["rows"]) == len(rows)


def test_more_devices_than_there_are_is_an_error() -> None:
    with pytest.raises(BenchmarkError, match="there are 1 devices, not 4"):
        scaling.run(scaling.Plan(CASES[:1], ("fast",), ("cpu",), (1, 4)), lambda _: None)

"""Numbers of matching that users do not set: each says its unit and its reason, and names its row of the ablation."""

import json
from collections.abc import Iterator
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from benchmarks.ablation import VARIANTS
from lfgpu.config import as_dict, restored
from lfgpu.methods import METHODS, PRESETS
from lfgpu.methods.matching import tuning
from lfgpu.methods.matching.config import MatchingConfig

ABLATION = Path(__file__).parents[1] / "benchmarks" / "results" / "ablation.json"


def numbers() -> Iterator[tuple[str, Field[Any]]]:
    for section in fields(tuning.MatchingTuning):
        if is_dataclass(section.default):
            yield from ((f"{section.name}.{number.name}", number) for number in fields(section.default))


@pytest.mark.parametrize(("name", "number"), list(numbers()), ids=lambda value: value if isinstance(value, str) else "")
def test_every_number_says_why_and_names_a_row_that_there_is(name: str, number: Field[Any]) -> None:
    meta = number.metadata
    assert len(meta["reason"].split()) >= 6
    assert meta["reason"].endswith((".", "counts as guessed."))
    assert isinstance(meta["unit"], str)
    if meta["ablation"]:
        measured = {record["name"] for record in json.loads(ABLATION.read_text())["records"]}
        (variant,) = (variant for variant in VARIANTS if variant.name == meta["ablation"])
        assert variant.name in measured
        assert name in variant.values, "the variant changes this number"


def test_a_changed_number_is_for_experiments_only() -> None:
    """Files name the tuning, and hold none of its numbers."""
    changed = PRESETS["fast"].with_tuning({"alignment.robust": 0.02, "sweep.step": 0.3})  # type: ignore[attr-defined]
    assert isinstance(changed, MatchingConfig)
    assert (changed.tuning.name, changed.tuning.alignment.robust, changed.sweep.step) == ("", 0.02, 0.3)
    kept = restored(as_dict(changed), METHODS["matching"].presets)
    assert kept == PRESETS["fast"].with_values({"sweep.step": 0.3})
    assert as_dict(PRESETS["fast"])["tuning"] == "fast"

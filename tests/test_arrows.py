"""Imports run one way: from front ends down to data and the contract, never up and never in a circle."""

import re

import arrows
import pytest

FLOOR = {name: level for level, floor in enumerate(arrows.FLOORS) for name in floor}
KERNELS_MAY = {"contract", "errors", "threads", "vulkan", "kernels"}


def test_arrows_lead_down_and_in_no_circle() -> None:
    assert {arrows.room(module) for module in arrows.arrows()} == set(FLOOR)
    assert arrows.circles() == []
    between = arrows.between_rooms()
    assert not [(a, b) for a, targets in between.items() for b in targets if a in between[b]]
    assert arrows.between_rooms()["kernels"] <= KERNELS_MAY
    for module, targets in arrows.arrows().items():
        parts = module.split(".")
        if parts[1] == "kernels" and len(parts) > 2:
            assert {t.split(".")[2] for t in targets if t.startswith("lfgpu.kernels.")} <= {parts[2]}, module
    for module in arrows.files():
        for target, name in arrows.imported(module):
            private = name.startswith("_") or any(part.startswith("_") for part in target.split(".")[2:])
            assert not private or arrows.room(target) == arrows.room(module), f"{module} imports {target}.{name}"


@pytest.mark.parametrize("name", sorted(FLOOR))
def test_no_arrow_leads_up(name: str) -> None:
    for module, targets in arrows.arrows().items():
        if arrows.room(module) == name:
            for target in targets:
                assert FLOOR.get(arrows.room(target), -1) >= FLOOR[name], f"{module} imports {target}"


def test_arrows_are_seen_and_drawn() -> None:
    """The derivation follows relative imports, imports inside functions and those for type checkers."""
    found = arrows.arrows()
    assert "lfgpu.kernels.warp.vector" in found["lfgpu.kernels.warp.backend"]
    assert "lfgpu.pipelines.estimate" in found["lfgpu.cli.options"]
    assert "lfgpu.methods.base" in found["lfgpu.methods"]
    assert arrows.DRAWING.read_text(encoding="utf-8") == arrows.drawing(), "run: python tests/arrows.py"


def test_the_page_names_every_room() -> None:
    page = (arrows.ROOT / "docs" / "house.md").read_text(encoding="utf-8")
    named = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)))
    assert sorted(named) == sorted(FLOOR)

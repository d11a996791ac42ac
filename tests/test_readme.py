"""The README says what the code does: its table of parameters, its commands, its three lines of Python."""

import re
from pathlib import Path

import lfgpu
from lfgpu import scenes
from lfgpu.config import parameters
from lfgpu.io import FORMATS
from lfgpu.methods import PRESETS

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def _cells(first: str) -> list[str]:
    line = next(line for line in README.splitlines() if line.startswith(f"| `{first}` |"))
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_every_parameter_stands_in_the_table_with_its_default_range_and_meaning() -> None:
    table = README.split("<!-- parameters -->")[1].split("<!-- /parameters -->")[0]
    for name, field in parameters(PRESETS["paper"]):
        meta = field.metadata
        if "choices" in meta:
            default, extent = f"`{field.default}`", ", ".join(meta["choices"])
        else:
            default = f"{field.default:g}"
            extent = f"{meta['low']:g} to {meta['high']:g}" + (", odd" if meta["odd"] else "")
        symbol = meta["symbol"].replace("|", r"\|")
        assert _cells(name) == [f"`{name}`", symbol, default, extent, meta["doc"]]
    assert table.count("\n| `") == len(dict(parameters(PRESETS["paper"])))


def test_every_format_and_scene_is_named() -> None:
    for entry in FORMATS:
        assert f"| `{entry.name}` |" in README
    for name in scenes.NAMES:
        assert f"`{name}`" in README


def test_the_names_of_the_python_example_exist() -> None:
    for name in re.findall(r"lfgpu\.(\w+)\(", README):
        assert hasattr(lfgpu, name), name
    methods = re.findall(r"pipeline\.(\w+)\(", README)
    assert {"upload", "run", "disparity"} <= set(methods)
    for name in methods:
        assert hasattr(lfgpu.DepthPipeline, name), name


def test_pictures_and_commands_exist() -> None:
    root = Path(__file__).parents[1]
    for target in re.findall(r"\]\(([\w/]+\.png)\)", README):
        assert (root / target).is_file()
    rules = (root / "Makefile").read_text()
    for rule in re.findall(r"^    make (\w+)", README, re.MULTILINE):
        assert f"\n{rule}:" in rules

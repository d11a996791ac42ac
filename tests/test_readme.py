"""The README says what the code does: its table of parameters, its commands, its three lines of Python."""

import re
from pathlib import Path

import parameters_page

import lfgpu
from lfgpu import scenes
from lfgpu.io import FORMATS

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_page_of_parameters_is_what_they_say_of_themselves() -> None:
    found = parameters_page.PAGE.read_text(encoding="utf-8")
    assert found == parameters_page.page(), "run: python tests/parameters_page.py"


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

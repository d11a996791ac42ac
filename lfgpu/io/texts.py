"""Texts in files (descriptions, parameters, attributes), which are small."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import read_as, reason_of

_LARGEST = 1 << 24  # bytes; a description of 100 000 views needs less

# What may be a dotted key of many parts: the parser takes a time that grows with their square, or faster.
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_DEEP_KEY = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*{_PART}){{64}}")


def read_text(path: Path, *, errors: str = "strict", largest: int = _LARGEST) -> str:
    """Read a regular file of text in UTF-8, with or without a mark at its beginning.

    Raises
    ------
    LightFieldError
        If it cannot be read, is no regular file (a pipe would be waited for), or is longer than `largest` bytes.
    UnicodeDecodeError
        If it is not UTF-8, unless `errors` is "replace".
    """
    with read_as(path):
        if not path.is_file():
            raise LightFieldError(f"{path} is not a file.")
        size = path.stat().st_size
        if size > largest:
            raise LightFieldError(f"{path} has {size} bytes; a text of its kind has at most {largest}.")
        with path.open("rb") as file:
            return file.read(largest).decode("utf-8-sig", errors)


def read_json_or_toml(path: Path, *, largest: int = _LARGEST) -> Any:
    """Parse a JSON file (.json) or a TOML file (any other suffix).

    Raises
    ------
    LightFieldError
        If it cannot be read, is too long, or is not valid.
    """
    kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
    try:
        text = read_text(path, largest=largest)
        if kind == "JSON":
            return json.loads(text)
        if _DEEP_KEY.search(text):
            raise ValueError("it has a key of more parts than any entry may have")
        return tomllib.loads(text)
    except LightFieldError:
        raise
    except (ValueError, RecursionError) as error:
        raise LightFieldError(f"{path} is not valid {kind}: {reason_of(error)}.") from error

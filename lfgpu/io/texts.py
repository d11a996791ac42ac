"""Texts in files (descriptions, parameters, attributes), which are small, and JSON objects whose members have types."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import read_as, reason_of

_LARGEST = 1 << 24  # bytes; a description of 100 000 views needs less

# What may be a dotted key of many parts: the parser takes a time that grows with their square, or faster.
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_DEEP_KEY = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*{_PART}){{64}}")


def read_text(path: Path, *, errors: str = "strict", largest: int = _LARGEST) -> str:
    """Read a regular file of UTF-8 text of at most `largest` bytes; UnicodeDecodeError unless `errors` is "replace"."""
    with read_as(path):
        if not path.is_file():
            raise LightFieldError(f"{path} is not a file.")
        size = path.stat().st_size
        if size > largest:
            raise LightFieldError(f"{path} has {size} bytes; a text of its kind has at most {largest}.")
        with path.open("rb") as file:
            return file.read(largest).decode("utf-8-sig", errors)


def read_json_or_toml(path: Path, *, largest: int = _LARGEST) -> Any:
    """Parse a JSON file (.json) or a TOML file (any other suffix); LightFieldError if it is not valid."""
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


def to_toml(table: Mapping[str, Any]) -> str:
    """Write a table as TOML: scalars and lists first, then tables, and those in lists, a line for each entry."""
    lines = [f"{key} = {_toml_value(value)}" for key, value in table.items() if not _is_table(value)]
    for key, value in table.items():
        for entry in (value if isinstance(value, list) else [value]) if _is_table(value) else ():
            heading = f"[[{key}]]" if isinstance(value, list) else f"[{key}]"
            lines += ["", heading, *(f"{name} = {_toml_value(part)}" for name, part in entry.items())]
    return "\n".join(lines).lstrip() + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _toml_value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_toml_value(entry) for entry in value)}]"
    if isinstance(value, str):  # JSON escapes as TOML does, but for one character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


_MOST = 10_000  # entries of a list


class Members:
    """The members of a JSON object in a file; `name` is where in the metadata it stands, such as "image.color"."""

    def __init__(self, path: Path, values: dict[str, Any], name: str = "") -> None:
        self._path, self.values, self._name = path, values, name

    def object(self, key: str) -> Members:
        """Return a member that is an object itself."""
        return Members(self._path, self._member(key, dict, "an object"), self._full(key))

    def objects(self, key: str) -> list[Members]:
        """Return a member that is a list of objects."""
        entries = self._member(key, list, "a list")
        if len(entries) > _MOST or not all(isinstance(entry, dict) for entry in entries):
            raise LightFieldError(f"{self._path} is damaged: its metadata has no list of objects as {self._full(key)}.")
        return [Members(self._path, entry, f"{self._full(key)}[{i}]") for i, entry in enumerate(entries)]

    def text(self, key: str) -> str:
        """Return a member that is a text."""
        return str(self._member(key, str, "a text"))

    def number(self, key: str, lowest: float, highest: float) -> float:
        """Return a member that is a number within bounds."""
        value = self._member(key, (int, float), "a number")
        if isinstance(value, bool) or not lowest <= value <= highest:
            raise LightFieldError(
                f"{self._path} is damaged: its metadata has {self._full(key)} = {value!r}, "
                f"not a number from {lowest:g} to {highest:g}."
            )
        return float(value)

    def integer(self, key: str, lowest: int, highest: int) -> int:
        """Return a member that is a whole number within bounds."""
        value = self.number(key, lowest, highest)
        if not value.is_integer():
            raise LightFieldError(f"{self._path} is damaged: its metadata has {self._full(key)} = {value!r}.")
        return int(value)

    def find(self, *keys: str) -> Any:
        """Return what stands at a path of keys, of any type; None if one of them is missing."""
        value: Any = self.values
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    def find_number(self, *keys: str) -> float | None:
        """Return a finite number at a path of keys; None if there is none."""
        value = self.find(*keys)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
            return None
        return float(value)

    def find_text(self, *keys: str) -> str | None:
        """Return a short text at a path of keys, on one line; None if there is none."""
        value = self.find(*keys)
        return " ".join(value.split())[:80] or None if isinstance(value, str) else None

    def _member(self, key: str, kind: type | tuple[type, ...], wanted: str) -> Any:
        value = self.values.get(key)
        if not isinstance(value, kind):
            found = "nothing" if key not in self.values else f"a JSON {type(value).__name__}"
            raise LightFieldError(
                f"{self._path} is damaged or of an unknown kind: its metadata has {found} for {self._full(key)}, "
                f"where {wanted} should be."
            )
        return value

    def _full(self, key: str) -> str:
        return f"{self._name}.{key}" if self._name else key

"""The page of all parameters, from what each says about itself.

python tests/parameters_page.py      # writes docs/parameters.md
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from lfgpu.config import Config, parameters
from lfgpu.methods import METHODS

PAGE = Path(__file__).parents[1] / "docs" / "parameters.md"

_HEAD = """\
# Parameters

Each method has parameters of its own, in sections. Set one with `--set section.parameter=value` on the command line,
or with `config.with_values({"section.parameter": value})` in Python. `lfgpu parameters --preset NAME` lists them too. A
parameter that the method of the preset does not read is refused.

The default is the value in the first preset of the method; other presets are named where their value is another.
"""


def page() -> str:
    """The whole page as Markdown."""
    parts = [_HEAD]
    for name, entry in METHODS.items():
        parts.append(f"## {name}: {entry.label}\n")
        parts.append("| parameter | default | range | what it is |\n|---|---|---|---|")
        parts += [_row(key, field, entry.presets) for key, field in parameters(entry.config)]
        parts.append("")
    return "\n".join(parts)


def _row(name: str, field: dataclasses.Field[object], presets: Mapping[str, Config]) -> str:
    meta, (section, parameter) = field.metadata, name.split(".")
    values = {preset: getattr(getattr(config, section), parameter) for preset, config in presets.items()}
    first, *_ = values.values()
    shown = [_value(first), *(f"`{preset}`: {_value(other)}" for preset, other in values.items() if other != first)]
    if "choices" in meta:
        extent = ", ".join(meta["choices"])
    else:
        extent = f"{meta['low']:g} to {meta['high']:g}" + (", odd" if meta["odd"] else "")
    symbol = f", {meta['symbol']}" if meta["symbol"] else ""
    return f"| `{name}`{symbol} | {'; '.join(shown)} | {extent} | {meta['doc']} |"


def _value(value: object) -> str:
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

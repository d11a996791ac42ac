"""The page of all parameters, from what each says about itself.

python tests/parameters_page.py      # writes docs/parameters.md
"""

import dataclasses
from pathlib import Path

from lfgpu.config import Config, parameters
from lfgpu.methods import METHODS

PAGE = Path(__file__).parents[1] / "docs" / "parameters.md"

_HEAD = """\
# Parameters

Each method has parameters of its own, in sections. Set one with `--set section.parameter=value` on the command line,
or with `config.with_values({"section.parameter": value})` in Python. `lfgpu parameters --preset NAME` lists them too. A
parameter that the method of the preset does not read is refused.
"""


def page() -> str:
    """The whole page as Markdown."""
    parts = [_HEAD]
    for name, entry in METHODS.items():
        default, *others = entry.presets
        parts.append(f"## {name}: {entry.label}\n")
        columns = "".join(f" `{other}` |" for other in others)
        parts.append(
            f"| parameter | symbol | `{default}` |{columns} range | what it is |\n"
            f"|---|---|---|{'---|' * len(others)}---|---|"
        )
        parts += [_row(key, field, list(entry.presets.values())) for key, field in parameters(entry.config)]
        parts.append("")
    return "\n".join(parts)


def _row(name: str, field: dataclasses.Field[object], presets: list[Config]) -> str:
    meta, (section, parameter) = field.metadata, name.split(".")
    first, *others = (getattr(getattr(preset, section), parameter) for preset in presets)
    shown = [_value(first), *(_value(other) if other != first else "" for other in others)]
    if "choices" in meta:
        extent = ", ".join(meta["choices"])
    else:
        extent = f"{meta['low']:g} to {meta['high']:g}" + (", odd" if meta["odd"] else "")
    symbol = meta["symbol"].replace("|", r"\|")
    return f"| `{name}` | {symbol} | {' | '.join(shown)} | {extent} | {meta['doc']} |"


def _value(value: object) -> str:
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

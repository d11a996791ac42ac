"""Links that lead out of docs/: to the page of the site that holds that file, or to the file in the repository.

Pages of docs/ and files beside it link to each other by relative paths, so that links work in a checkout. In the site
they work as well.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
PAGES = {
    "CHANGELOG.md": "changes",
    "CONTRIBUTING.md": "contributing",
    "SECURITY.md": "security",
    "benchmarks/README.md": "benchmarks",
    "benchmarks/ablation.md": "ablation",
    "benchmarks/measuring.md": "measuring",
    "benchmarks/tried.md": "tried",
    "kernels/README.md": "backend",
    "benchmarks/results/README.md": "measured",
}
"""Files outside docs/ that are pages of the site, as docs/made/NAME.md."""

_REPOSITORY = "https://github.com/lfgpu/lfgpu/blob/main/"
_LINK = re.compile(r"(!\[[^\]\n]*)?(\]\()([^)#:\s]+)(#[^)\s]*)?(\))")
_PATTERN = re.compile(r"^((?:\.\./)?[\w-]+\*)\n", re.MULTILINE)


def led(text: str, source: Path, page: Path) -> str:
    """The text of a Markdown file with links that hold in the site.

    Parameters
    ----------
    text
        What the file says.
    source
        The file: its links are relative to this.
    page
        Where the site reads it from; the same file for a page of docs/.
    """
    parts = re.split(r"(^```.*?^```)", text, flags=re.MULTILINE | re.DOTALL)  # code is left alone
    return "".join(
        part if part.startswith("```") else _LINK.sub(lambda m: _link(m, source, page), part) for part in parts
    )


def _link(found: re.Match[str], source: Path, page: Path) -> str:
    picture, target, place, after = found[1] or "", found[3], found[4] or "", found[5]
    before = picture + found[2]
    path = Path(os.path.normpath(source.parent / target))
    if not path.is_relative_to(ROOT) or not path.exists():
        return found[0]  # for Sphinx to complain about
    name = path.relative_to(ROOT).as_posix()
    if name in PAGES:
        path = DOCS / "made" / f"{PAGES[name]}.md"
    elif not path.is_relative_to(DOCS) and not picture:
        return f"{before}{_REPOSITORY}{name}{place}{after}"
    return f"{before}{os.path.relpath(path, page.parent)}{place}{after}"


def _read(app: Sphinx, name: str, source: list[str]) -> None:
    path = Path(app.env.doc2path(name))
    if path.suffix == ".md" and not path.is_relative_to(DOCS / "made"):
        source[0] = _PATTERN.sub(lambda m: m[0] if _matches(path.parent, m[1]) else "", led(source[0], path, path))


def _matches(folder: Path, pattern: str) -> bool:
    """Whether a line of a table of contents names a page. Places for pages that are not there yet are left out."""
    folder = folder / Path(pattern).parent
    return any(folder.glob(f"{Path(pattern).name}.md"))


def setup(app: Sphinx) -> dict[str, bool]:
    """Change links as pages are read."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

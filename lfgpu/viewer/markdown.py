"""Text in what the page takes for Markdown, and so for HTML and for names of files to be shown."""

from __future__ import annotations

import string

from lfgpu.printable import printable

_LONGEST = 2000  # characters
_WRITTEN_OUT = {ord(character): f"&#{ord(character)};" for character in string.punctuation}


def plain(text: str) -> str:
    """A text that is shown as it is, whatever it holds: names and what files say must not become part of the page."""
    return printable(text, longest=_LONGEST).translate(_WRITTEN_OUT)

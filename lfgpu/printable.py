"""Text that came from outside, made safe to show: in messages, on terminals, in pages."""

from __future__ import annotations

import unicodedata

_LONGEST = 1000  # characters of a message: names of files reach 255, paths 4096
_JOINERS = "\u200c\u200d"  # invisible, but letters of Persian, Hindi and others stand or fall with them


def printable(text: str, *, keep: str = "", longest: int | None = None) -> str:
    r"""A text in which everything that is not seen is written out: the escape character becomes "\x1b".

    Terminals obey control characters, letters of the other direction can turn a name round, and half of a character
    beyond 16 bits (bytes of a name that are not UTF-8) cannot be encoded. Accents, other scripts and emoji stay.

    Parameters
    ----------
    text
        Any text.
    keep
        Characters that stay as they are, "\n" for example.
    longest
        How many characters are left of it; the middle of a longer one becomes an ellipsis. None leaves all.
    """
    if longest is not None and len(text) > longest:
        half = (longest - 3) // 2
        text = f"{text[:half]} … {text[-half:]}"
    if text.isprintable():
        return text
    kept = keep + _JOINERS
    return "".join(c if _is_seen(c) or c in kept else c.encode("unicode_escape").decode() for c in text)


def _is_seen(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"  # spaces of all widths


def message(text: str) -> str:
    """A message on one line, not longer than can be read."""
    return printable(" ".join(text.split()) if "\n" in text else text, longest=_LONGEST)

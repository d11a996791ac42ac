"""Text that came from outside, made safe to show: in messages, on terminals, in pages."""

import unicodedata

_LONGEST = 1000  # characters of a message: names of files reach 255, paths 4096
_JOINERS = "\u200c\u200d"  # invisible, but letters of Persian, Hindi and others stand or fall with them


def printable(text: str, *, keep: str = "", longest: int | None = None) -> str:
    r"""Write out everything in a text that is not seen, but for `keep`: the escape character becomes "\x1b".

    Terminals obey control characters, letters of the other direction can turn a name round, and half of a character
    beyond 16 bits (bytes of a name that are not UTF-8) cannot be encoded. Accents, other scripts and emoji stay. The
    middle of a text with more than `longest` characters becomes an ellipsis.
    """
    if longest is not None:
        text = _shortened(text, longest)  # before what nobody sees of a long text is written out
    kept = keep + _JOINERS
    written = text if text.isprintable() else "".join(_seen(c, kept) for c in text)
    return written if longest is None else _shortened(written, longest)


def _shortened(text: str, longest: int) -> str:
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]} … {text[-half:]}"


def _seen(character: str, kept: str) -> str:
    if character.isprintable() or unicodedata.category(character) == "Zs" or character in kept:  # spaces of all widths
        return character
    return character.encode("unicode_escape").decode()


def message(text: str) -> str:
    """Put a message on one line, not longer than can be read."""
    return printable(" ".join(text.split()) if "\n" in text else text, longest=_LONGEST)

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
    kept = keep + _JOINERS
    if longest is None or len(text) <= longest:
        written = text if text.isprintable() else "".join(_seen(c, kept) for c in text)
        if longest is None or len(written) <= longest:
            return written
    half = (longest - 3) // 2
    return f"{_beginning(text, half, kept)} … {_beginning(text[::-1], half, kept, backwards=True)}"


def _beginning(text: str, most: int, kept: str, *, backwards: bool = False) -> str:
    """Return the characters of a text, from its start, that are at most so many when they are written out."""
    pieces: list[str] = []
    for c in text:
        piece = _seen(c, kept)
        most -= len(piece)
        if most < 0:
            break
        pieces.append(piece)
    return "".join(pieces[::-1] if backwards else pieces)


def _seen(character: str, kept: str) -> str:
    if _is_seen(character) or character in kept:
        return character
    return character.encode("unicode_escape").decode()


def _is_seen(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"  # spaces of all widths


def message(text: str) -> str:
    """Put a message on one line, not longer than can be read."""
    return printable(" ".join(text.split()) if "\n" in text else text, longest=_LONGEST)

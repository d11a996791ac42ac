"""The chain of pages of a TIFF file, followed by itself before a library does: it may be a circle."""

import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from lfgpu.errors import LightFieldError

_MOST = 100_000  # pages; no light field has as many views
_KINDS = {
    **{b"II*\0": ("<I", "<H", 12), b"MM\0*": (">I", ">H", 12)},
    **{b"II+\0": ("<Q", "<Q", 20), b"MM\0+": (">Q", ">Q", 20)},
}
"""By the first bytes: how offsets and counts are stored, and the bytes of an entry."""
MAGICS = tuple(_KINDS)
_WHOLE = {3: "H", 4: "I", 16: "Q"}  # types of whole numbers
_KIND, _WIDTH, _HEIGHT = 254, 256, 257  # tags
_NO_PICTURE = 1 | 4  # bits of the kind of a page: a smaller copy, a mask


def pages(path: Path) -> Iterator[int]:
    """Yield the offset of each page; LightFieldError if one is linked twice, or there are more than anyone needs."""
    with path.open("rb") as file:
        start = file.read(16)
        if start[:4] not in _KINDS or len(start) < 16:
            return
        link, count, entry = _KINDS[start[:4]]
        seen: set[int] = set()
        offset = struct.unpack_from(link, start, struct.calcsize(link))[0]
        while offset:
            if offset in seen:
                raise LightFieldError(f"{path} is damaged: its pages are linked in a circle.")
            if len(seen) == _MOST:
                raise LightFieldError(f"{path} has more than {_MOST} pages; a light field has one for each view.")
            seen.add(offset)
            yield offset
            try:
                file.seek(offset)
                entries = struct.unpack(count, file.read(struct.calcsize(count)))[0]
                file.seek(entry * entries, 1)
                offset = struct.unpack(link, file.read(struct.calcsize(link)))[0]
            except (struct.error, OSError, OverflowError, ValueError):  # who reads the page says what is wrong
                return


def check_pages(path: Path) -> None:
    """Raise LightFieldError unless the chain of pages ends."""
    for _ in pages(path):
        pass


def further_pictures(path: Path) -> int:
    """Count the pages after the first that are as large as it, and neither smaller copies of it nor masks."""
    found: list[dict[int, int]] = []
    with suppress(LightFieldError):  # linked in a circle: those before it
        found.extend(numbers(path, offset) for offset in pages(path))
    tags = [(page.get(_WIDTH), page.get(_HEIGHT), page.get(_KIND, 0) & _NO_PICTURE) for page in found]
    return tags[1:].count((*tags[0][:2], 0)) if tags else 0


def numbers(path: Path, at: int) -> dict[int, int]:
    """Read the tags of a page that are one whole number, up to where it is damaged."""
    found: dict[int, int] = {}
    with path.open("rb") as file, suppress(struct.error, OSError, OverflowError, ValueError):
        link, count, size = _KINDS[file.read(4)]
        order, head = link[0], f"{link[0]}HH{link[1]}"
        file.seek(at)
        for _ in range(struct.unpack(count, file.read(struct.calcsize(count)))[0]):
            entry = file.read(size)
            tag, kind, values = struct.unpack_from(head, entry)
            if kind in _WHOLE and values == 1:
                found[tag] = struct.unpack_from(order + _WHOLE[kind], entry, struct.calcsize(head))[0]
    return found

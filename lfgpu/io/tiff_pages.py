"""The chain of pages of a TIFF file, followed by itself before a library does: it may be a circle."""

import struct
from collections.abc import Iterator
from pathlib import Path

from lfgpu.errors import LightFieldError

_MOST = 100_000  # pages; no light field has as many views
_KINDS = {42: ("I", "H", 12), 43: ("Q", "Q", 20)}  # by version: how offsets and counts are stored, bytes of an entry


def pages(path: Path) -> Iterator[int]:
    """Yield the offset of each page; LightFieldError if one is linked twice, or there are more than anyone needs."""
    with path.open("rb") as file:
        start = file.read(16)
        order = {b"II": "<", b"MM": ">"}.get(start[:2])
        if order is None or len(start) < 16:
            return
        version = struct.unpack(f"{order}H", start[2:4])[0]
        if version not in _KINDS:
            return
        link_kind, count_kind, entry = _KINDS[version]
        link, count = order + link_kind, order + count_kind
        seen: set[int] = set()
        offset = struct.unpack(link, start[4:8] if version == 42 else start[8:])[0]
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

"""Damage that knows a format: what it leaves is read far before it is refused, as its checksums and lengths are right.

Each function takes the bytes of a file and returns others; a file that it cannot take apart raises, and is damaged
without such knowledge then.
"""

import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

EXTREMES = (0, 1, 2, 3, 255, 256, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x10000, 100_000, 2**63 - 1)
VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1, 2.5, 1e308, -1e-308, 10**400, "", "nan", "\ud800", "\x1b[2J", "<script>", "..", "a/b"),
    *("x" * 5000, [], [0], [0, 0], [[0, 0]], [1e999, 1], {}, {"a": 1}, [[]] * 50),
)
"""What may stand in JSON and TOML, and should not stand there."""

Mutation = Callable[[bytes, np.random.Generator], bytes]


def pick(rng: np.random.Generator, options: Any) -> Any:
    return options[int(rng.integers(len(options)))]


def flipped(data: bytes, rng: np.random.Generator, most: int = 4) -> bytes:
    """With a few bytes changed."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, most + 1))):
        if changed:
            changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def word(data: bytes, rng: np.random.Generator, order: str, within: int = 1 << 30) -> bytes:
    """With a number of 2, 4 or 8 bytes, at a place where such a number may stand, changed."""
    changed, width = bytearray(data), pick(rng, (2, 4, 8))
    places = range(0, max(1, min(len(data), within) - width + 1), 2)
    at = pick(rng, places)
    value = pick(rng, EXTREMES) if rng.random() < 0.7 else int(rng.integers(64))
    changed[at : at + width] = (value % (1 << (8 * width))).to_bytes(width, "little" if order == "<" else "big")
    return bytes(changed)


# --- pictures ---


def png(data: bytes, rng: np.random.Generator) -> bytes:
    """Chunks changed, lost, doubled or in another order; their checksums are right."""
    chunks, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    index = int(rng.integers(len(chunks)))
    kind, content = chunks[index]
    match int(rng.integers(6)):
        case 0:
            del chunks[index]
        case 1:
            chunks.insert(int(rng.integers(len(chunks) + 1)), (kind, content))
        case 2:
            chunks[index] = kind, word(content, rng, ">")
        case 3:
            chunks[index] = kind, flipped(content, rng)
        case 4:
            header = bytearray(chunks[0][1])
            header[int(rng.integers(8, 13))] = int(rng.integers(20))  # depth, colours, packing, filter, interlacing
            chunks[0] = chunks[0][0], bytes(header)
        case 5:
            pixels = zlib.decompress(b"".join(content for kind, content in chunks if kind == b"IDAT"))
            others = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
            chunks = [*others[:-1], (b"IDAT", zlib.compress(flipped(pixels, rng, 50))), others[-1]]
    return data[:8] + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks
    )


def jpeg(data: bytes, rng: np.random.Generator) -> bytes:
    """A segment before the pixels changed, lost, doubled, or with a wrong length."""
    pieces, at = [], 2
    while data[at + 1] != 0xDA:
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        pieces.append(data[at : at + 2 + length])
        at += 2 + length
    index = int(rng.integers(len(pieces)))
    match int(rng.integers(4)):
        case 0:
            del pieces[index]
        case 1:
            pieces.insert(int(rng.integers(len(pieces) + 1)), pieces[index])
        case 2:
            pieces[index] = pieces[index][:4] + flipped(pieces[index][4:], rng)
        case 3:
            pieces[index] = pieces[index][:2] + struct.pack(">H", pick(rng, EXTREMES) % 0x10000) + pieces[index][4:]
    return data[:2] + b"".join(pieces) + data[at:]


def webp(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk of another kind, size or content, or one more before it: an extended header, an animation, a profile."""
    kind, content = data[12:16], data[20:]
    side = struct.pack("<I", pick(rng, EXTREMES) % (1 << 32))[:3]
    more = {
        b"VP8X": bytes([int(rng.integers(256)), 0, 0, 0]) + side + side,
        b"ANIM": bytes(6),
        b"ANMF": bytes(6) + side + side + bytes(4) + data[12:],
        b"ICCP": b"x" * int(rng.integers(300)),
    }
    chunks = [(kind, content)]
    match int(rng.integers(4)):
        case 0:
            chunks[0] = pick(rng, (b"VP8 ", b"VP8L", b"ALPH", b"EXIF")), content
        case 1:
            chunks[0] = kind, flipped(content[:20], rng) + content[20:]
        case _:
            chosen = pick(rng, list(more))
            chunks.insert(0, (chosen, more[chosen]))
    body = b"WEBP" + b"".join(
        name + struct.pack("<I", len(inside)) + inside + bytes(len(inside) % 2) for name, inside in chunks
    )
    return b"RIFF" + struct.pack("<I", len(body)) + body


def exr(data: bytes, rng: np.random.Generator) -> bytes:
    """An attribute of the header with another content, size, type or name, or the table of offsets changed."""
    attributes, at = [], 8
    while data[at]:
        name, kind = data[at:].split(b"\0", 2)[:2]
        start = at + len(name) + len(kind) + 2
        (length,) = struct.unpack("<I", data[start : start + 4])
        attributes.append((name, kind, data[start + 4 : start + 4 + length]))
        at = start + 4 + length
    index = int(rng.integers(len(attributes)))
    name, kind, content = attributes[index]
    match int(rng.integers(6)):
        case 0:
            del attributes[index]
        case 1:
            attributes.append(attributes[index])
        case 2:
            attributes[index] = name, pick(rng, [other for _, other, _ in attributes]), content
        case 3:
            attributes[index] = pick(rng, (b"", b"\x1b[2J", b"x" * 300, b"tiles", b"channels")), kind, content
        case 4:
            return data[:at] + word(data[at:], rng, "<", 64)
        case 5:
            attributes[index] = name, kind, word(content, rng, "<") if len(content) > 2 else flipped(content, rng)
    head = b"".join(name + b"\0" + kind + b"\0" + struct.pack("<I", len(inside)) + inside
                    for name, kind, inside in attributes)  # fmt: skip
    return data[:8] + head + data[at:]


def bmp(data: bytes, rng: np.random.Generator) -> bytes:
    """A number of the header changed."""
    return word(data, rng, "<", 54)


def tiff(data: bytes, rng: np.random.Generator) -> bytes:
    """Entries of a page changed, or the link to the next page, to another one for example."""
    order = {b"II": "<", b"MM": ">"}[data[:2]]
    changed, pages, at = bytearray(data), [], struct.unpack(f"{order}I", data[4:8])[0]
    while at and at not in pages and len(pages) < 100:
        pages.append(at)
        count = struct.unpack(f"{order}H", data[at : at + 2])[0]
        at = struct.unpack(f"{order}I", data[at + 2 + 12 * count : at + 6 + 12 * count])[0]
    page = pick(rng, pages)
    count = struct.unpack(f"{order}H", data[page : page + 2])[0]
    if rng.random() < 0.25:
        link, to = page + 2 + 12 * count, pick(rng, (*pages, len(data) - 1, 8))
        changed[link : link + 4] = struct.pack(f"{order}I", to)
        return bytes(changed)
    entry = page + 2 + 12 * int(rng.integers(count))
    tags = (254, 256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 284, 317, 330, 339)
    fields = ((0, "H", tags), (2, "H", range(20)), (4, "I", EXTREMES[:11]), (8, "I", (*EXTREMES[:11], *pages)))
    offset, kind, values = pick(rng, fields)
    changed[entry + offset : entry + offset + struct.calcsize(kind)] = struct.pack(order + kind, pick(rng, values))
    return bytes(changed)


# --- arrays ---


def npy(data: bytes, rng: np.random.Generator) -> bytes:
    """Another shape, type or order in the header."""
    file = io.BytesIO(data)
    np.lib.format.read_magic(file)
    np.lib.format.read_array_header_1_0(file)
    header, content = data[10 : file.tell()], data[file.tell() :]
    side = str(pick(rng, (0, 1, 2, 5, -1, 10**6, 2**31, 2**62, 10**30)))
    header = pick(
        rng,
        (
            re.sub(rb"\d+(?=[,)])", side.encode(), header, count=int(rng.integers(1, 6))),
            re.sub(rb"'descr': '[^']*'", f"'descr': {pick(rng, _DTYPES)!r}".encode(), header),
            re.sub(rb"'fortran_order': \w+", b"'fortran_order': True", header),
            re.sub(rb"'shape': \([^)]*\)", pick(rng, (b"'shape': ()", b"'shape': (3,)", b"'shape': None")), header),
        ),
    ).rstrip()
    header = header + b" " * (-(len(header) + 11) % 64) + b"\n"
    return data[:8] + struct.pack("<H", len(header)) + header + content


_DTYPES = ("|u1", "<u2", ">f4", "<f8", "<c16", "|O", "|b1", "<U9", "|V7", "<M8[s]", "<f2", [("a", "<i4")], "x")


def npz(data: bytes, rng: np.random.Generator) -> bytes:
    """One of its arrays changed, lost, doubled, renamed; or the JSON in it."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    index = int(rng.integers(len(members)))
    texts = [place for place, (_, content) in enumerate(members) if b"'<U" in content[:120]]
    if texts and rng.random() < 0.5:
        index = pick(rng, texts)
        name, content = members[index]
        text = str(np.load(io.BytesIO(content)))
        changed = io.BytesIO()
        np.save(changed, np.array(tree(text.encode(), rng).decode()))
        members[index] = name, changed.getvalue()
    else:
        name, content = members[index]
        match int(rng.integers(5)):
            case 0:
                del members[index]
            case 1:
                members[index] = pick(rng, members)[0], content
            case 2:
                members[index] = pick(rng, ("", "../x.npy", "a\x1b.npy", "x" * 3000)), content
            case 3:
                members[index] = name, npy(content, rng)
            case 4:
                members[index] = name, flipped(content, rng, 20)
    made = io.BytesIO()
    packing = pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(made, "w", packing) as archive:  # names twice
        for name, content in members:
            archive.writestr(name, content)
    return made.getvalue()


def matlab(data: bytes, rng: np.random.Generator) -> bytes:
    """A tag or a number of a variable changed, also within what is packed."""
    at, order = 128, "<"
    while at < len(data):
        kind, length = struct.unpack("<II", data[at : at + 8])
        content = data[at + 8 : at + 8 + length]
        if rng.random() < 0.5 or at + 8 + length >= len(data):
            if kind == 15:
                content = zlib.compress(word(zlib.decompress(content), rng, order, 200))
            else:
                content = word(content, rng, order, 200)
            return data[:at] + struct.pack("<II", kind, len(content)) + content + data[at + 8 + length :]
        at += 8 + length
    return data


def hdf5(path: Path, rng: np.random.Generator) -> None:
    """Datasets and attributes of other shapes and types, and links of all kinds."""
    import h5py

    with h5py.File(path, "r+") as file:
        names = list(file)
        name = pick(rng, names)
        match int(rng.integers(7)):
            case 0:
                del file[name]
            case 1:
                value = pick(rng, VALUES)
                file.attrs[pick(rng, ("dH", "dV", "focalLength", "shift", "x"))] = value if value is not None else "x"
            case 2:
                kind = pick(rng, ("u1", "<u2", "f8", "c8", "S4", "?", "i8"))
                shape = tuple(int(side) for side in rng.integers(0, 4, int(rng.integers(0, 7))))
                del file[name]
                file[name] = np.zeros(shape, kind)
            case 3:
                del file[name]
                file[name] = pick(rng, (h5py.SoftLink(f"/{name}"), h5py.SoftLink("/"), h5py.SoftLink("/nowhere")))
            case 4:
                del file[name]
                file[name] = h5py.ExternalLink(path.name, f"/{name}")
            case 5:
                del file[name]
                file.create_dataset(name, (9, 9, 40_000, 40_000, 3), "u1", chunks=(1, 1, 100, 100, 3))
            case 6:
                del file[name]
                file.create_group(name)


def binary(data: bytes, rng: np.random.Generator) -> bytes:
    """One of its numbers changed, as COLMAP's binary models and plain arrays have them."""
    return word(data, rng, "<", 600)


# --- containers ---


def lytro(data: bytes, rng: np.random.Generator) -> bytes:
    """A Lytro container: JSON of a section changed, a section lost, doubled, renamed, emptied or with other content."""
    sections, at = [], 16
    while at + 16 <= len(data):
        (length,) = struct.unpack(">I", data[at + 12 : at + 16])
        start = at + 16 + 80
        sections.append((data[at : at + 12], data[at + 16 : start], data[start : start + length]))
        at = -(-(start + length) // 16) * 16
    texts = [place for place, (_, _, content) in enumerate(sections) if content[:1] == b"{" and len(content) > 2]
    index = pick(rng, texts) if rng.random() < 0.8 else int(rng.integers(len(sections)))
    head, name, content = sections[index]
    match int(rng.integers(10)):
        case 0:
            del sections[index]
        case 1:
            sections.insert(int(rng.integers(len(sections) + 1)), sections[index])
        case 2:
            sections[index] = head, pick(rng, sections)[1], content
        case 3:
            sections[index] = head, name, b""
        case 4:
            sections[index] = head, name, pick(rng, sections)[2]
        case 5:
            sections[index] = head, name, flipped(content, rng, 20)
        case _:
            sections[index] = head, name, tree(content, rng)
    made = data[:16]
    for head, name, content in sections:
        made += head + struct.pack(">I", len(content)) + (name + content if content else b"")
        made += bytes(-len(made) % 16)
    return made


# --- texts ---


def tree(data: bytes, rng: np.random.Generator) -> bytes:
    """JSON with one of its values replaced, lost or doubled."""
    found = json.loads(data)
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            places.append((node, key))
            collect(node[key])

    collect(found)
    if not places:
        return json.dumps(pick(rng, VALUES)).encode()
    for _ in range(int(rng.integers(1, 4))):
        node, key = pick(rng, places)
        if isinstance(node, list) and key >= len(node):
            continue
        match int(rng.integers(4)):
            case 0 if isinstance(node, dict):
                node.pop(key, None)
            case 1 if isinstance(node, list):
                node.append(node[key])
            case _:
                node[key] = pick(rng, VALUES)
    return json.dumps(found).encode()


def lines(data: bytes, rng: np.random.Generator) -> bytes:
    """A text of `key = value` with a value replaced, a line lost, doubled or moved, or a key of many parts."""
    found = data.decode(errors="replace").splitlines()
    index = int(rng.integers(len(found)))
    key, sign, value = found[index].partition("=")
    match int(rng.integers(6)):
        case 0:
            del found[index]
        case 1:
            found.insert(int(rng.integers(len(found) + 1)), found[index])
        case 2:
            found.insert(index, f"{'a.' * int(pick(rng, (1, 70, 5000)))}a = 1")
        case 3:
            found.insert(index, pick(rng, ("[geometry]", "[[views]]", "[truth]", "[source]", "[x]", "[a.b]", "= 1")))
        case _ if sign:
            values = ("nan", "inf", "-1", "0", "1e999", "9" * 400, "0x" + "f" * 5000, '""', "[]", "[0, 0]", "true",
                      "1979-05-27", '"../x.png"', '"."', "[" * 2000, '"\\u0000"', "{a = 1}")  # fmt: skip
            found[index] = f"{key}= {_renumbered(value, rng) if rng.random() < 0.5 else pick(rng, values)}"
    return "\n".join(found).encode()


def _renumbered(text: str, rng: np.random.Generator) -> str:
    """A text with one of its numbers replaced."""
    places = list(re.finditer(r"-?\d[\d.e+-]*", text))
    if not places:
        return text
    match = pick(rng, places)
    value = pick(rng, ("", "0", "1", "-1", "1e300", "1e-300", "9" * 30, "nan", "x", "[]", "2, 3", "1.5"))
    return text[: match.start()] + value + text[match.end() :]


def yaml(data: bytes, rng: np.random.Generator) -> bytes:
    """YAML with a value replaced, also by aliases and tags, or with a line lost, doubled, moved or deeper."""
    found = data.decode(errors="replace").splitlines()
    index = int(rng.integers(len(found)))
    key, sign, value = found[index].partition(": ")
    match int(rng.integers(6)):
        case 0:
            del found[index]
        case 1:
            found.insert(int(rng.integers(len(found) + 1)), found[index])
        case 2:
            found[index] = " " * int(rng.integers(1, 9)) + found[index]
        case 3:
            laughs = [f"y{n}: &y{n} [{', '.join([f'*y{n - 1}'] * 9) if n else '1'}]" for n in range(9)]
            found += [*laughs, f"{key.strip() or 'x'}: *y8"]
        case _ if sign:
            value = _renumbered(value, rng) if rng.random() < 0.5 else pick(rng, _YAML_VALUES)
            found[index] = f"{key}: {value}"
    return "\n".join(found).encode()


_YAML_VALUES = (
    *("~", "0", "-1", ".nan", "-.inf", "1e999", "9" * 400, "[]", "{}", "[[]]", "true", "2001-01-01", "1:60:61", "0o8"),
    *("&a [*a]", "*nowhere", "? x", "[" * 3000, '"\\ud800"', "!x y", "!!binary x", "!!set {1, 2}"),
    *("!!python/object/apply:os.getcwd []", "!!opencv-matrix 5", "!!opencv-matrix {rows: 3, cols: 3, dt: d, data: []}"),
    "!!opencv-matrix {rows: 99999999, cols: 99999999, dt: d, data: [1]}",
)


def words(data: bytes, rng: np.random.Generator) -> bytes:
    """A table of words, as COLMAP's texts are, with a word replaced, lost or doubled, or a line lost or doubled."""
    found = data.decode(errors="replace").splitlines()
    index = int(rng.integers(len(found)))
    parts = found[index].split(" ")
    place = int(rng.integers(len(parts)))
    match int(rng.integers(5)):
        case 0:
            del found[index]
        case 1:
            found.insert(int(rng.integers(len(found) + 1)), found[index])
        case 2:
            found[index] = " ".join(parts[:place])
        case _:
            parts[place] = pick(
                rng, ("", "0", "1", "-1", "nan", "inf", "1e999", "9" * 400, "x", "PINHOLE", "FOV", "\x1b")
            )
            found[index] = " ".join(parts)
    return "\n".join(found).encode()


def table(data: bytes, rng: np.random.Generator) -> bytes:
    """A manifest: some of its lines changed as JSON."""
    found = data.splitlines()
    index = int(rng.integers(len(found)))
    found[index] = tree(found[index], rng)
    return b"\n".join(found) + b"\n"


def header(data: bytes, rng: np.random.Generator) -> bytes:
    """Numbers in a header that is a text, as PFM and PLY have it."""
    numbers = list(re.finditer(rb"-?\d[\d.]*", data[:2000]))
    match = pick(rng, numbers)
    value = pick(rng, (b"0", b"1", b"-1", b"7", b"99999999", b"nan", b"1e999", b"9" * 40, b""))
    return data[: match.start()] + value + data[match.end() :]


BY_SUFFIX: dict[str, Mutation] = {
    **{".png": png, ".tif": tiff, ".npy": npy, ".npz": npz, ".mat": matlab, ".json": tree, ".toml": lines},
    **{".cfg": lines, ".dat": lines, ".jsonl": table, ".pfm": header, ".ply": header, ".ppm": header},
    **{".jpg": jpeg, ".webp": webp, ".exr": exr, ".bmp": bmp, ".lfp": lytro},
    **{".yaml": yaml, ".txt": words, ".bin": binary},
}

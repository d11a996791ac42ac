"""PLY files: what is written is read back, by others too, and what is no file of points is refused."""

from pathlib import Path

import numpy as np
import pytest
from samples import refusal

import lfgpu
from lfgpu.data.result import DisparityMap
from lfgpu.io.ply import read_ply, write_ply

POINTS = np.zeros(5, [("x", "f4"), ("y", "f8"), ("z", ">f4"), ("red", "u1"), ("row", "i4"), ("kind", "u2")])
for _number, _name in enumerate(POINTS.dtype.names or ()):
    POINTS[_name] = np.arange(5) + 10 * _number


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_ply(tmp_path / "a.ply", POINTS, ["first", "second: 1 2 3"])
    return tmp_path / "a.ply"


def test_points_and_comments_come_back(file: Path) -> None:
    points, comments = read_ply(file)
    assert comments == ["first", "second: 1 2 3"]
    assert points.dtype.names == POINTS.dtype.names
    for name in POINTS.dtype.names or ():
        np.testing.assert_array_equal(points[name], POINTS[name])


def test_other_programs_read_them(file: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    np.testing.assert_array_equal(trimesh.load(file, process=False).vertices[:, 1], POINTS["y"])


def test_what_other_programs_write_is_read(file: Path, tmp_path: Path) -> None:
    """Lines that end as on Windows, sized names of types, remarks, and faces after the points."""
    head, _, data = file.read_bytes().partition(b"end_header\n")
    head = head.replace(b"property float", b"property float32").replace(b"\n", b"\r\n")
    faces = b"element face 1\r\nproperty list uchar int vertex_indices\r\n"
    (tmp_path / "b.ply").write_bytes(head + b"obj_info here\r\n" + faces + b"end_header\r\n" + data + bytes(13))
    np.testing.assert_array_equal(read_ply(tmp_path / "b.ply")[0]["z"], POINTS["z"])


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (b"ply\n", b"plx\n", "its header is missing or damaged"),
        (b"end_header", b"end_of_it", "its header is missing or damaged"),
        (b"binary_little_endian", b"ascii", "must be binary and little endian"),
        (b"binary_little_endian", b"binary_big_endian", "must be binary and little endian"),
        (b"element vertex 5", b"element vertex 6", "claims 6 points and ends before them"),
        (b"element vertex 5", b"element vertex 99999999999999999999", "ends before them"),
        (b"element vertex 5", b"element vertex -5", "must come first"),
        (b"element vertex", b"element face", "must come first"),
        (b"property float x", b"property list uchar float x", "be numbers"),
        (b"property float x", b"property text x", "be numbers"),
        (b"property float x", b"property float y", "be numbers"),
    ],
)
def test_what_is_no_file_of_points_is_refused(file: Path, before: bytes, after: bytes, words: str) -> None:
    file.write_bytes(file.read_bytes().replace(before, after, 1))
    assert words in refusal(lambda: read_ply(file))


@pytest.mark.parametrize("name", ["row", "column"])
def test_points_beside_the_map_are_refused(tmp_path: Path, name: str) -> None:
    lfgpu.save(DisparityMap(np.ones((8, 9), np.float32)), tmp_path / "a.ply")
    points, comments = read_ply(tmp_path / "a.ply")
    for wrong in (-1, 9):
        points[name][3] = wrong
        write_ply(tmp_path / "b.ply", points, comments)
        assert "are not those of a map" in refusal(lambda: lfgpu.load(tmp_path / "b.ply"))

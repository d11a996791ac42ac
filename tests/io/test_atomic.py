"""Files and folders are written whole or not at all."""

import errno
import re
import signal
import subprocess
import sys
import threading
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import lfgpu, refused as refused_command
from samples import refusal

from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_folder, atomic_write, check_writable, read_map, write_pfm
from lfgpu.io.atomic import _remove_remnants


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    with atomic_write(path) as temporary:
        temporary.write_text("old")
        assert temporary.suffix == ".txt"
        assert not path.exists()
    with atomic_write(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyboardInterrupt("mine"), ValueError("mine")])
def test_nothing_is_written_at_all(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "out").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for context in (
        atomic_write(tmp_path / "a.txt"),
        atomic_write(tmp_path / "new" / "deep" / "b.txt"),
        atomic_folder(tmp_path / "out"),
        atomic_folder(tmp_path / "new" / "out"),
    ):
        with pytest.raises(type(error), match="mine"):
            interrupted(context, error)
    assert (tmp_path / "a.txt").read_text() == "old"
    assert sorted(tmp_path.rglob("*")) == before


def interrupted(context: AbstractContextManager[Path], error: BaseException) -> None:
    """Write half of a file, or into a folder, and fail."""
    with context as temporary:
        (temporary / "a.txt" if temporary.is_dir() else temporary).write_text("half")
        raise error


def test_a_folder_is_written_whole(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with atomic_folder(out) as temporary:
        (temporary / "a.txt").write_text("1")
        (temporary / "deep").mkdir()
        (temporary / "deep" / "b.txt").write_text("1")
        assert not out.exists()
    (out / "mine.txt").write_text("mine")
    with atomic_folder(out) as temporary:
        (temporary / "a.txt").write_text("2")
        assert (out / "a.txt").read_text() == "1"
    contents = {str(p.relative_to(out)): p.read_text() for p in out.rglob("*") if p.is_file()}
    assert contents == {"a.txt": "2", str(Path("deep", "b.txt")): "1", "mine.txt": "mine"}
    assert list(tmp_path.iterdir()) == [tmp_path / "new"]
    assert list((tmp_path / "new").iterdir()) == [out]


def test_an_error_names_the_place_where_a_file_was_to_be(tmp_path: Path) -> None:
    wanted = re.escape(f"{tmp_path / 'out' / 'map.pfm'} cannot be written: No space")
    folders = atomic_folder(tmp_path / "out")
    with pytest.raises(LightFieldError, match=wanted), folders as folder, atomic_write(folder / "map.pfm"):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_new_files_have_the_usual_permissions_and_links_are_written_through(tmp_path: Path) -> None:
    (tmp_path / "plain.txt").write_text("")
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode
    (tmp_path / "real").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "real")
    with atomic_folder(link) as temporary:
        (temporary / "a.txt").write_text("")
    file_link = tmp_path / "link.txt"
    file_link.symlink_to(tmp_path / "real" / "a.txt")
    with atomic_write(file_link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert file_link.is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


def test_writers_at_the_same_time_do_not_disturb_each_other(tmp_path: Path) -> None:
    def write(index: int) -> None:
        for _ in range(10):
            write_pfm(tmp_path / "a.pfm", np.full((20, 20), index))

    threads = [threading.Thread(target=write, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(np.unique(read_map(tmp_path / "a.pfm"))) == 1
    assert len(list(tmp_path.iterdir())) == 1


_KILLED = """
import os, signal, sys
from pathlib import Path
from lfgpu.io import atomic_folder, atomic_write
with atomic_write(Path(sys.argv[1], "a.txt")) as file, atomic_folder(Path(sys.argv[1], "out")) as folder:
    file.write_text("half")
    (folder / "b.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_with_the_next_output_and_nothing_else(tmp_path: Path) -> None:
    killed = subprocess.run([sys.executable, "-c", _KILLED, tmp_path], check=False)
    assert killed.returncode == -signal.SIGKILL
    remnants = set(tmp_path.iterdir())
    assert len(remnants) == 2
    assert {path.read_text() for path in tmp_path.rglob("*.txt")} == {"half"}
    (tmp_path / ".lfgpu-mine").mkdir()
    with atomic_write(tmp_path / "a.txt") as temporary:
        assert not remnants & set(tmp_path.iterdir())
        _remove_remnants.cache_clear()  # as another process
        with atomic_write(tmp_path / "b.txt") as other:
            other.write_text("")
            temporary.write_text("it is not taken for a remnant")
    assert {path.name for path in tmp_path.iterdir()} == {"a.txt", "b.txt", ".lfgpu-mine"}


def test_a_folder_that_another_process_makes_meanwhile_gets_the_files(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with atomic_folder(out) as folder:
        (folder / "a.txt").write_text("ours")
        out.mkdir()
        (out / "a.txt").write_text("theirs")
        (out / "b.txt").write_text("theirs")
    assert {path.name: path.read_text() for path in out.iterdir()} == {"a.txt": "ours", "b.txt": "theirs"}
    assert list(out.parent.iterdir()) == [out]


def test_places_that_cannot_be_written_are_found_early_and_late(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.write_text("mine")
    for out in (file, file / "out", file / "deep" / "out"):
        assert f"{file} is a file" in refusal(lambda out=out: check_writable(out))
        assert str(out) in refusal(lambda out=out: enter(atomic_folder(out)))
    assert f"{tmp_path} cannot be written: it is a folder" in refusal(lambda: check_writable(tmp_path, folder=False))
    assert f"{tmp_path} cannot be written: it is a folder" in refusal(lambda: enter(atomic_write(tmp_path)))
    assert f"{file} is a file" in refusal(lambda: check_writable(file / "a.pfm", folder=False))
    assert str(file / "a.pfm") in refusal(lambda: write_pfm(file / "a.pfm", np.zeros((3, 7), np.float32)))
    assert file.read_text() == "mine"


@pytest.mark.parametrize("name", ["x" * 300, f"new/{'x' * 300}/a", "a/" * 3000])
def test_a_name_that_is_too_long_is_found_early_and_late(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for is_folder in (True, False):
        refused = refusal(lambda is_folder=is_folder: check_writable(tmp_path / name, folder=is_folder))
        assert re.fullmatch(r".* cannot be written: File name too long\.", refused)
    for context in (atomic_folder(tmp_path / name), atomic_write(tmp_path / name)):
        assert "too long" in refusal(lambda context=context: enter(context))
    monkeypatch.chdir(tmp_path)
    refused_command(lfgpu("scene", "boxes", "-o", name), "too long")
    assert list(tmp_path.iterdir()) == []


def enter(context: Any) -> None:
    with context:
        pass


def test_places_that_can_be_written_pass_and_nothing_is_made(tmp_path: Path) -> None:
    (tmp_path / "a.pfm").write_text("")
    for place, is_folder in (("", True), ("new/deep", True), ("a.pfm", False), ("new/a.pfm", False)):
        check_writable(tmp_path / place, folder=is_folder)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.pfm"]


@pytest.mark.usefixtures("_permissions_count")
def test_places_without_permission(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    (closed / "open").mkdir(parents=True)
    closed.chmod(0o500)
    try:
        for out in (closed, closed / "new", closed / "new" / "deep"):
            assert f"no permission to write in {closed}" in refusal(lambda out=out: check_writable(out))
            assert "Permission denied" in refusal(lambda out=out: enter(atomic_folder(out)))
        assert f"no permission to write in {closed}" in refusal(lambda: check_writable(closed / "a", folder=False))
        check_writable(closed / "open")  # as a mounted folder in a container is
        with atomic_folder(closed / "open") as temporary:
            (temporary / "a.txt").write_text("")
        assert (closed / "open" / "a.txt").exists()
        closed.chmod(0)
        assert f"no permission to write in {closed}" in refusal(lambda: check_writable(closed / "open" / "new"))
    finally:
        closed.chmod(0o700)


def test_files_of_an_earlier_run_go_where_its_mark_is(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for new in (("a.txt",), ("b.txt", "mark")):
        out.mkdir(exist_ok=True)
        (out / "mine.txt").write_text("mine")
        with atomic_folder(out, ours=("a.txt", "b.txt", "mark"), mark="mark") as folder:
            for name in new:
                (folder / name).write_text("new")
    assert {path.name for path in out.iterdir()} == {"a.txt", "b.txt", "mark", "mine.txt"}  # a.txt may be of others
    with pytest.raises(KeyboardInterrupt):
        interrupted(atomic_folder(out, ours=("a.txt", "b.txt", "mark"), mark="mark"), KeyboardInterrupt())
    assert len(list(out.iterdir())) == 4
    with atomic_folder(out, ours=("a.txt", "b.txt", "mark"), mark="mark") as folder:
        (folder / "mark").write_text("new")
    assert {path.name for path in out.iterdir()} == {"mark", "mine.txt"}


def test_a_folder_in_the_way_of_one_file_leaves_all_files_as_they_were(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "b.txt").mkdir(parents=True)
    (out / "a.txt").write_text("old")

    def write() -> None:
        with atomic_folder(out) as folder:
            for name in ("a.txt", "b.txt", "c.txt"):
                (folder / name).write_text("new")

    with pytest.raises(LightFieldError, match=r"b\.txt is in the way"):
        write()
    assert (out / "a.txt").read_text() == "old"
    assert sorted(path.name for path in out.iterdir()) == ["a.txt", "b.txt"]

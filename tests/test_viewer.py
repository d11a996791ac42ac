"""The viewer without a browser: updates, estimates, its address and the command."""

import re
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, lfgpu, refused
from walls import SIZE, wall

from lfgpu import scenes
from lfgpu.cli.options import Reading
from lfgpu.errors import LightFieldError
from lfgpu.io import write_pfm
from lfgpu.methods import preset
from lfgpu.viewer import Viewer
from lfgpu.viewer.contents import LIVE, Contents
from lfgpu.viewer.place import Place
from lfgpu.viewer.solving import Progress, Request, Solver

_EVERYTHING = """
import sys
from lfgpu import Viewer, estimate_depth, scenes
from lfgpu.viewer import pictures, saving
from lfgpu.viewer.space import Space
lf = scenes.make("boxes", grid=(3, 3), size=(32, 40))
with Viewer(lf, port=0) as viewer:
    before = set(sys.modules)
    pictures.prepare()
    for preset in ("fast", "paper"):
        viewer.add(estimate_depth(lf, config=preset), name=preset)
    limits, colours = (-1.0, 1.0), "viridis"
    saving.figure(viewer.contents, "fast", "disparity", "final", colours=colours, limits=limits)
    saving.saved(viewer.contents, "fast", "final", ".ply")
    Space(viewer, print).close()
ours = {"lfgpu", "scipy", "matplotlib", "viser", "trimesh"}
print(sorted(name for name in set(sys.modules) - before if name.split(".")[0] in ours))
"""


def test_nothing_is_imported_once_kernels_are_loaded() -> None:
    """Both parse Python, which two threads must not do: pictures, estimates and 3D come in threads of their own."""
    found = subprocess.run([sys.executable, "-c", _EVERYTHING], capture_output=True, text=True, timeout=300)
    assert found.stdout.splitlines()[-1:] == ["[]"], found.stdout + found.stderr


def test_updates_come_from_any_thread_and_wrong_ones_are_refused() -> None:
    pytest.importorskip("viser")
    lf = wall(1.0)
    with Viewer(lf, port=0) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")
        buffer = np.zeros(SIZE, np.float32)
        pushers = [threading.Thread(target=viewer.update, args=(buffer,)) for _ in range(4)]
        for pusher in pushers:
            pusher.start()
        for pusher in pushers:
            pusher.join()
        buffer += 9  # its owner writes the next frame to it
        assert not viewer.contents.entries[LIVE].disparity.any()
        viewer.update(buffer, views=lf.views)
        with pytest.raises(LightFieldError, match="what is shown has 32 x 24"):
            viewer.update(np.zeros((5, 6)))
        with pytest.raises(LightFieldError, match="confidence must be"):
            viewer.update(buffer, np.zeros((2, 2)))
        with pytest.raises(LightFieldError, match="views must be"):
            viewer.update(buffer, views=lf.views[1:])
        with pytest.raises(LightFieldError, match=r"\[y, x\]"):
            viewer.update(np.zeros(3))
    viewer.close()  # twice does no harm


def test_an_estimate_can_be_stopped_and_made_again() -> None:
    said: list[Progress] = []
    done = threading.Event()
    solver = Solver(said.append, lambda *_: done.set())
    request = Request(scenes.make("relief", grid=(3, 3), size=SIZE), preset("paper"), (-2, 2), "mine")
    assert solver.start(request)
    assert not solver.start(request)
    solver.stop()
    solver.close()
    assert said[-1].text == "stopped"
    assert not done.is_set()
    assert solver.start(request)
    solver._thread.join(60)
    assert done.is_set()
    assert said[-1].text.startswith("mine: done in")
    assert not solver.progress.busy
    shares = [progress.share for progress in said[said.index(next(p for p in said if "local" in p.text)) :]]
    assert max(shares) == 100


def test_an_estimate_that_fails_says_why() -> None:
    said: list[Progress] = []
    solver = Solver(said.append, lambda *_: pytest.fail("there is no result"))
    assert solver.start(Request(wall(1.0), preset("fast"), (-900, 900)))
    solver._thread.join(60)
    assert "give smaller disparities" in said[-1].text
    assert not said[-1].busy


# --- the command ---


def view(*arguments: object) -> Outcome:
    return lfgpu("view", *arguments, "--port", "0")


def test_the_command_says_where_to_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser")
    write_pfm(tmp_path / "map.pfm", np.zeros((5, 6)))
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda _: None)
    outcome = view(tmp_path / "map.pfm")
    assert (outcome.code, outcome.err) == (0, "")
    assert re.search(r"http://127\.0\.0\.1:\d+/[\w-]{32}/ with a browser", outcome.out)
    assert viser.__name__ not in outcome.out


def test_the_command_reads_as_depth_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    lf = scenes.make("relief", grid=(3, 3), size=SIZE)
    np.save(tmp_path / "views.npy", lf.views[:6])
    write_pfm(tmp_path / "map.pfm", np.zeros(SIZE))
    shown: list[Contents] = []
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda viewer: shown.append(viewer.contents))
    outcome = view(tmp_path / "views.npy", tmp_path / "map.pfm", "--grid", "2x3", "--flip", "u")
    assert (outcome.code, outcome.err) == (0, "")
    assert shown[0].lf.grid_shape == (2, 3)
    np.testing.assert_array_equal(shown[0].lf.view(0, 0), lf.view(0, 2))
    assert list(shown[0].entries) == ["map"]
    refused(view(tmp_path / "map.pfm", "--grid", "2x3"), "map.pfm")


@pytest.mark.parametrize(
    ("name", "words"), [("nowhere", "does not exist"), ("empty", "an empty folder"), ("bad.pfm", "bad.pfm")]
)
def test_what_cannot_be_shown_is_a_sentence(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.pfm").write_bytes(b"PF?")
    refused(view(tmp_path / name), words)


def test_the_address_is_not_said_for_what_is_no_light_field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    monkeypatch.setattr("lfgpu.cli.view._SOON", 0)
    for options in ((), ("--format", "hologram")):
        outcome = view(tmp_path, *options)
        assert (outcome.code, outcome.out) == (1, "")


def test_the_command_says_where_to_look_before_all_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading waits here until the address was said."""
    said = threading.Event()
    monkeypatch.setattr("lfgpu.viewer.server.Viewer.wait", lambda _: None)
    monkeypatch.setattr(
        "lfgpu.viewer.board.opened_all", lambda *_, **__: Contents(wall(1.0)) if said.wait(60) else None
    )
    monkeypatch.setattr("lfgpu.cli.view.typer.echo", lambda text: said.set() if "Open http://" in text else None)
    write_pfm(tmp_path / "map.pfm", np.zeros((5, 6)))
    assert view(tmp_path / "map.pfm").code == 0
    assert said.is_set()


# --- its address ---


def test_the_address_is_known_before_anything_heavy_is_imported() -> None:
    code = (
        "import sys\n"
        "from lfgpu.viewer.place import Place\n"
        "place = Place(0)\n"
        "assert place.url.startswith('http://127.0.0.1:')\n"
        "assert not {'numpy', 'tornado', 'scipy'} & sys.modules.keys()\n"
        "import lfgpu.viewer.server, lfgpu.viewer.web\n"
        "assert not {'scipy', 'matplotlib', 'warp', 'viser', 'h5py', 'dask'} & sys.modules.keys()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_who_connects_early_is_answered_later() -> None:
    """The address is printed before the server is there."""
    pytest.importorskip("tornado")
    pytest.importorskip("viser")
    place = Place(0)
    with socket.create_connection(("127.0.0.1", place.port), 10) as early:
        early.sendall(f"GET /{place.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{place.port}\r\n\r\n".encode())
        with Viewer(port=place) as viewer:
            assert viewer.url == place.url
            assert early.recv(100).startswith(b"HTTP/1.1 200")


def test_a_port_that_is_taken_is_passed_over() -> None:
    first = Place(0)
    second = Place(first.port)
    assert second.port > first.port
    with pytest.raises(LightFieldError, match="there is no port 65536"):
        Place(65536)
    for place in (first, second):
        place.socket.close()


def test_commands_to_look_read_as_what_was_done_did() -> None:
    reading = Reading(grid="2x3", names="cam{u}", transpose=True, frame=1)
    assert reading.words() == ["--grid", "2x3", "--pattern", "cam{u}", "--frame", "1", "--transpose"]

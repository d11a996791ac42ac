"""Who the viewer answers, and what it answers to nonsense."""

import errno
import http.client
import json
import socket
import threading
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import save, write_hci
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.viewer import Viewer
from lfgpu.viewer.answers import DATA
from lfgpu.viewer.door import _STRANGERS
from lfgpu.viewer.place import Place
from tests.viewer.page import Page


def status(viewer: Viewer, path: str, *, body: bytes | None = None, **headers: str) -> int:
    found = urlsplit(viewer.url)
    request = Request(f"http://{found.netloc}{found.path}{path}", body, headers)
    try:
        with urlopen(request, timeout=10) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def post(viewer: Viewer, what: str, body: bytes, kind: str = "application/json", **headers: str) -> int:
    return status(viewer, f"do/{what}", body=body, **{"Content-Type": kind, **headers})


def answer_to(viewer: Viewer, *lines: str) -> str:
    """Send the lines of a head, and return the number of the answer."""
    with socket.create_connection(("127.0.0.1", urlsplit(viewer.url).port), 30) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        return connection.recv(200).decode().split()[1]


@pytest.mark.parametrize(
    ("path", "length", "answer"),
    [("/none/do/open", 1000, "403"), ("/none/do/open", 99 << 20, "403"), ("{own}do/open", 2 << 20, "400")],
)
def test_no_body_is_waited_for_that_will_not_be_used(viewer: Viewer, path: str, length: int, answer: str) -> None:
    found = urlsplit(viewer.url)
    head = f"POST {path.format(own=found.path)} HTTP/1.1"
    # The body never comes.
    assert answer_to(viewer, head, f"Host: {found.netloc}", f"Content-Length: {length}") == answer


@pytest.mark.parametrize(
    ("rest", "host", "more", "answer"),
    [
        ("", "[::1", "", "403"), ("", "[x]", "", "403"), ("", None, "Origin: http://[", "403"),
        ("%00", None, "", "404"), ("data/view%00", None, "", "404"), ("space/%00/x", None, "", "404"),
        ("%ff", None, "", "400"), ("x" * 5000, None, "", "404"),
    ],
)  # fmt: skip
def test_malformed_heads_are_refused(
    viewer: Viewer, rest: str, host: str | None, more: str, answer: str, caplog: pytest.LogCaptureFixture
) -> None:
    found = urlsplit(viewer.url)
    lines = [f"GET {found.path}{rest} HTTP/1.1", f"Host: {host or found.netloc}", *([more] if more else [])]
    assert answer_to(viewer, *lines) == answer
    assert not [record for record in caplog.records if record.name.startswith("lfgpu") or record.exc_info]


def test_connections_that_say_nothing_make_room(caplog: pytest.LogCaptureFixture) -> None:
    with Viewer(port=0) as viewer, ExitStack() as stack:
        port = urlsplit(viewer.url).port
        known = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
        silent = []
        for _ in range(5):
            known.request("GET", urlsplit(viewer.url).path)
            answer = known.getresponse()
            assert (answer.status, answer.read()[:5]) == (200, b"<!doc")
            assert known.sock is not None  # who has shown the token stays, however many come
            strangers = (socket.create_connection(("127.0.0.1", port), 30) for _ in range(2 * _STRANGERS))
            silent += map(stack.enter_context, strangers)
        for connection in silent[:-_STRANGERS]:
            assert connection.recv(1) == b""
    assert ["connections without the token are closed" in record.message for record in caplog.records] == [True]


class _Full:
    """A socket that cannot take connections for a while: the process has no descriptors left."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening, self.refusals = listening, 2

    def accept(self) -> Any:
        if self.refusals:
            self.refusals -= 1
            raise OSError(errno.EMFILE, "Too many open files")
        return self._listening.accept()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._listening, name)


def test_a_process_that_can_open_nothing_more_says_so_once_and_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    place = Place(0)
    place.socket = _Full(place.socket)  # type: ignore[assignment]
    with Viewer(port=place) as viewer:
        assert status(viewer, "") == 200
    assert place.socket.refusals == 0  # type: ignore[attr-defined]
    assert [record.getMessage() for record in caplog.records] == [
        "connections without the token are closed: Too many open files"
    ]


def test_strangers_at_the_scene_in_space_leave_no_traceback(
    viewer: Viewer, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    from lfgpu.viewer.space import Space

    space = Space(viewer, lambda x, y: None)
    try:
        for words in (b"nonsense\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 100 + b"\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", space.port), 30) as connection:
                connection.sendall(words)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(1000):
                    pass
    finally:
        space.close()
    assert not [record for record in caplog.records if record.exc_info]
    assert "Traceback" not in capfd.readouterr().err


def test_nothing_is_reached_from_elsewhere(viewer: Viewer) -> None:
    port = urlsplit(viewer.url).port
    assert port is not None
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)} - {"127.0.0.1"}
    for address in {*others, "127.0.0.2"}:
        with socket.socket() as probe:
            probe.settimeout(2)
            assert probe.connect_ex((address, port)) != 0, address
    with socket.create_connection(("127.0.0.1", port), 2):
        pass


@pytest.mark.parametrize(("origin", "answer"), [("http://evil.example", "403"), ("null", "403"), (None, "101")])
def test_pages_of_other_sites_are_refused(viewer: Viewer, origin: str | None, answer: str) -> None:
    found = urlsplit(viewer.url)
    own = f"http://{found.netloc}"
    lines = [
        f"GET {found.path}tab HTTP/1.1", f"Host: {found.netloc}", f"Origin: {origin or own}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
    ]  # fmt: skip
    assert answer_to(viewer, *lines) == answer
    assert post(viewer, "open", b'{"path": ""}', Origin=origin or own) == (403 if origin else 400)


def test_forms_and_names_of_other_machines_are_refused(viewer: Viewer) -> None:
    assert post(viewer, "stop", b"{}", "text/plain") == 415
    for body in (b"[]", b"[" * 100_000, b'{"name": ' + b"9" * 5000 + b"}"):
        assert post(viewer, "stop", body) == 400
    assert status(viewer, "", Host="evil.example") == 403
    assert status(viewer, "") == 200


@pytest.mark.parametrize("path", ["/", "/index.html", "/x/", "/?token=x", "/x/index.html", "/x/data/fixed", "/x/tab"])
def test_nobody_without_the_token_is_answered(viewer: Viewer, path: str) -> None:
    with pytest.raises(HTTPError, match="403"):
        urlopen(f"http://{urlsplit(viewer.url).netloc}{path}", timeout=10)
    with urlopen(viewer.url, timeout=10) as answer:
        assert b"<html" in answer.read()
        assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("path", "answer"),
    [
        ("../web.py", 404), ("%2e%2e/web.py", 403), ("data/nothing", 404), ("style.css", 200),
        ("data/view?index=99&level=0&column=0&row=0", 400),
        ("data/view?index=0&level=99&column=0&row=0", 400), ("data/view?index=x&level=0&column=0&row=0", 400),
        ("data/view?index=nan&level=0&column=0&row=0", 400), ("data/map?result=none&kind=disparity", 400),
        ("file/figure?result=fast&kind=disparity&colours=viridis&low=-1e308&high=1e308", 400),
        ("data/epi?along=row&at=-1", 400), ("data/refocused?disparity=inf&aperture=1&level=0", 400),
        ("file/result?result=fast&suffix=.jpg", 400), ("file/space?tab=x", 400), ("space/x/", 404),
    ],
)  # fmt: skip
def test_nonsense_is_answered_with_a_sentence(
    viewer: Viewer, path: str, answer: int, capfd: pytest.CaptureFixture[str]
) -> None:
    assert status(viewer, path) in {answer, 403 if ".." in path else answer}
    assert capfd.readouterr().err == ""


def test_pages_that_close_while_they_are_answered_leave_no_traceback(
    viewer: Viewer, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gone, answered = threading.Event(), threading.Event(), threading.Event()

    def slow(*_: object) -> np.ndarray:
        begun.set()
        gone.wait(30)
        answered.set()
        return np.zeros(3, np.uint8)

    monkeypatch.setitem(DATA, "slow", slow)
    found = urlsplit(viewer.url)
    with socket.create_connection(("127.0.0.1", found.port), 5) as connection:
        connection.sendall(f"GET {found.path}data/slow HTTP/1.1\r\nHost: {found.netloc}\r\n\r\n".encode())
        assert begun.wait(30)
    assert status(viewer, "") == 200  # the server has noticed by now that the page has gone
    gone.set()
    assert answered.wait(30)
    for _ in range(3):
        assert status(viewer, "") == 200
    assert not [record for record in caplog.records if record.exc_info]


_PAYLOAD = '<img src=x onerror="window.owned = 1"><script>window.owned = 2</script>'


def test_text_from_files_does_not_become_part_of_the_page(browser: Any, lf: LightField, tmp_path: Path) -> None:
    """A result with a script in its status, in a folder with a script in its name."""
    folder = tmp_path / _PAYLOAD.replace("/", ".")
    folder.mkdir()
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    save(replace(result, status=_PAYLOAD, device=_PAYLOAD, backend=_PAYLOAD), folder / "result.npz")
    write_hci(lf, tmp_path / "boxes")
    with Viewer.of([tmp_path / "boxes", folder], port=0) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")
        page.says(_PAYLOAD, "#about")
        page.tab.wait_for_timeout(300)  # for what would be run
        assert page.tab.evaluate("window.owned") is None
        assert page.tab.locator("img[src=x]").count() == 0


@pytest.mark.parametrize("wish", [{"range": [0, 10**400]}, {"range": [-1e300, 1]}, {"values": [1]}, {"preset": {}}])
def test_estimates_that_cannot_be_are_answered_with_a_sentence(viewer: Viewer, wish: dict[str, Any]) -> None:
    assert post(viewer, "estimate", json.dumps({"preset": "fast", **wish}).encode()) == 400


def test_pages_open_only_what_was_given(files: Path, lf: LightField, tmp_path: Path) -> None:
    write_hci(lf, tmp_path / "other")
    (tmp_path / "link").symlink_to(files / "fast")
    with Viewer.of([files / "boxes"], port=0) as viewer:
        for path in (tmp_path / "other", files / "fast", files / "boxes" / ".." / "fast", tmp_path / "link", "/"):
            with pytest.raises(LightFieldError, match="--allow-open"):
                viewer.open_from_page(path)
            assert post(viewer, "open", json.dumps({"path": str(path)}).encode()) == 400
        viewer.open_from_page(files / "boxes")
        viewer.open(files / "fast")  # its owner may


def test_nonsense_from_a_page_leaves_the_others_alone(
    page: Page, viewer: Viewer, caplog: pytest.LogCaptureFixture, rng: np.random.Generator
) -> None:
    from websockets.sync.client import connect

    address = viewer.url.replace("http://", "ws://") + "tab"
    scenes = ['{"x": 1e999}', '{"low": NaN}', '{"result": "fast", "exposure": 1e6}', '{"low": 1' + "0" * 400 + "}"]
    scenes += ['{"size": []}', '{"of": 1}', '{"__class__": {}}', "1"]
    others = [b"", b"\xff" * 100, rng.bytes(1000), "text", "[]", "[" * 100_000]
    for data in (*others, *map('{{"scene": {}}}'.format, scenes)):
        with connect(address, origin=viewer.url.rsplit("/", 2)[0]) as connection:
            connection.send(data)
            with suppress(Exception):
                connection.recv(timeout=0.3)
    assert not [record for record in caplog.records if record.exc_info]  # else a traceback is on the terminal
    page.tab.keyboard.press("ArrowUp")
    page.shown("view", " 7 ")

"""Guard of the viewer: it answers those who know the token, by a name of this machine, and no pages of other sites."""

import asyncio
import logging
import secrets
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar
from urllib.parse import urlsplit

from tornado.http1connection import HTTP1Connection
from tornado.httputil import HTTPServerRequest
from tornado.iostream import StreamClosedError
from tornado.web import HTTPError, RequestHandler, stream_request_body
from tornado.websocket import WebSocketClosedError

from lfgpu.errors import LfgpuError
from lfgpu.printable import message
from lfgpu.viewer.board import Board
from lfgpu.viewer.door import Door
from lfgpu.viewer.facts import Facts
from lfgpu.viewer.pictures import prepare

_HOSTS = ("127.0.0.1", "localhost", "::1")
_NO_TOKEN = "The address of the page has a token; see lfgpu view"
_EXPECTED = (LfgpuError, HTTPError, WebSocketClosedError, StreamClosedError)  # said to the page, or it has gone
_T = TypeVar("_T")


class Site:
    """The site: what all handlers share."""

    door: Door

    def __init__(self, board: Board, token: str) -> None:
        self.board, self.facts = board, Facts(board)
        self.token = token
        """The first part of every path."""
        self.tabs: dict[str, Any] = {}
        """The tabs by their names."""
        self.pool, self.loop = ThreadPoolExecutor(4, "lfgpu-page"), asyncio.new_event_loop()
        self._is_prepared = False

    async def apart(self, work: Callable[..., _T], *arguments: Any) -> _T:
        """Do work in another thread, so that the server goes on answering."""
        return await asyncio.get_running_loop().run_in_executor(self.pool, work, *arguments)

    def call_soon(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Call something in the thread of the server; from any thread."""
        try:
            self.loop.call_soon_threadsafe(work, *arguments)
        except RuntimeError:
            logging.getLogger("lfgpu.viewer").debug("the server has ended")

    def prepare(self) -> None:
        """Load soon what pictures need that are computed, once."""
        if not self._is_prepared and self.board.contents.lf is not None:
            self._is_prepared = True
            self.pool.submit(prepare)


@stream_request_body
class Guarded(RequestHandler):
    """Answers only who knows the token, by a name of this machine, and no pages of other sites.

    The head of a request decides; its body is read afterwards, and kept by those who want one.
    """

    site: Site

    def initialize(self, site: Site) -> None:
        self.site = site

    async def prepare(self) -> None:
        given = (self.path_args or [""])[0] or ""
        if not secrets.compare_digest(given.encode(), self.site.token.encode()):
            raise HTTPError(403, reason=_NO_TOKEN)
        if not _is_of_this_machine(self.request):
            raise HTTPError(403, reason="The viewer answers to localhost only")
        origin = self.request.headers.get("Origin")
        if origin is not None and origin.partition("://")[2] != self.request.host:
            raise HTTPError(403, reason="Pages of other sites are not answered")
        if any("\0" in part for part in self.path_args):
            raise HTTPError(404)
        connection = self.request.connection
        assert isinstance(connection, HTTP1Connection)
        self.site.door.know(connection.stream)

    def data_received(self, chunk: bytes) -> None:
        """Forget a body that nobody wants."""

    def set_default_headers(self) -> None:
        self.set_header("Server", "lfgpu")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-store")

    def write_error(self, status_code: int, **options: Any) -> None:
        error = options.get("exc_info", (None, None, None))[1]
        sentence = f"{self._reason}."
        if isinstance(error, LfgpuError):
            sentence = message(str(error))
        elif status_code == 500:
            sentence = f"this failed, which is a bug: {type(error).__name__}: {error}"
        self.finish({"error": sentence})

    def log_exception(self, typ: Any, value: Any, tb: Any) -> None:
        if not isinstance(value, _EXPECTED):
            logging.getLogger("lfgpu.viewer").error("a page could not be answered", exc_info=(typ, value, tb))

    async def or_sentence(self, work: Awaitable[_T]) -> _T | None:
        """Return the result of some work; None if it failed with a sentence, which was sent."""
        try:
            return await work
        except LfgpuError as error:
            self.set_status(400)
            self.write_error(400, exc_info=(type(error), error, None))
            return None


def _is_of_this_machine(request: HTTPServerRequest) -> bool:
    try:
        return urlsplit(f"//{request.host}").hostname in _HOSTS
    except ValueError:  # no name of any machine
        return False


class Nothing(Guarded):
    """Everything without a token."""

    async def prepare(self) -> None:
        raise HTTPError(403, reason=_NO_TOKEN)

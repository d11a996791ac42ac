"""The web server of the viewer: the page, its data, and what it asks for. Everything lies behind the token."""

import asyncio
import json
import logging
import threading
from collections.abc import Awaitable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler

from lfgpu.errors import LightFieldError
from lfgpu.viewer.answers import ACTIONS, DATA, FILES, Query
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import Contents
from lfgpu.viewer.door import Door
from lfgpu.viewer.guard import Guarded, Nothing, Site
from lfgpu.viewer.place import Place
from lfgpu.viewer.tabs import LARGEST, InSpace, Tab

_PAGE = Path(__file__).parent / "page"
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; font-src 'self'; "
    "connect-src 'self' ws:; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors http://127.0.0.1:* http://localhost:*"  # notebooks
)
_LARGEST_BODY = 2**20  # bytes of a wish of the page
_PATIENCE = 60  # seconds for the head of a request, and for its body


class Server(Site):
    """The web server of a board, in a thread of its own."""

    def __init__(self, board: Board, place: Place) -> None:
        super().__init__(board, place.token)
        self._socket, self._ready = place.socket, threading.Event()
        self._stop: asyncio.Event | None = None
        logging.getLogger("tornado").addHandler(logging.NullHandler())  # else nonsense from others is on the terminal
        self._thread = threading.Thread(target=self._run, name="lfgpu-viewer", daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Close all tabs and free the port."""
        if self._stop is not None and not self.loop.is_closed():
            self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_until_complete(self._serve())
        finally:
            self.pool.shutdown(wait=False, cancel_futures=True)
            self.loop.close()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        options = {"site": self}
        application = Application(
            [
                (r"/([^/?]+)/data/(\w+)", _Data, options),
                (r"/([^/?]+)/file/(\w+)", _File, options),
                (r"/([^/?]+)/do/(\w+)", _Do, options),
                (r"/([^/?]+)/tab", Tab, options),
                (r"/([^/?]+)/space/([\w-]+)/?(.*)", InSpace, options),
                (r"/([^/?]+)/(.*)", _Page, {**options, "path": str(_PAGE), "default_filename": "index.html"}),
            ],
            default_handler_class=Nothing,
            default_handler_args=options,
            log_function=lambda _: None,
            websocket_ping_interval=20,
            websocket_max_message_size=LARGEST,
        )
        server = HTTPServer(
            application, max_body_size=_LARGEST_BODY, body_timeout=_PATIENCE, idle_connection_timeout=_PATIENCE
        )
        self.door = Door(server, self._socket)
        end = self.board.listen(lambda: self.call_soon(self._tell))
        self._ready.set()
        await self._stop.wait()
        end()
        self.door.close()
        for tab in list(self.tabs.values()):
            tab.close(1001, "the viewer has ended")
            tab.on_close()
        await asyncio.sleep(0.05)  # for the messages that say so
        await server.close_all_connections()

    def _tell(self) -> None:
        for tab in self.tabs.values():
            tab.wake()


class _Page(Guarded, StaticFileHandler):
    """The files of the page."""

    def initialize(self, site: Site, path: str, default_filename: str) -> None:  # type: ignore[override]
        Guarded.initialize(self, site)
        StaticFileHandler.initialize(self, path, default_filename)

    def set_default_headers(self) -> None:
        super().set_default_headers()
        self.set_header("Content-Security-Policy", _POLICY)

    def set_extra_headers(self, path: str) -> None:
        self.set_header("Cache-Control", "no-cache")

    async def get(self, _: str, path: str, include_body: bool = True) -> None:  # type: ignore[override]
        await StaticFileHandler.get(self, path, include_body)

    async def head(self, _: str, path: str) -> None:  # type: ignore[override]
        await StaticFileHandler.get(self, path, include_body=False)

    def write_error(self, status_code: int, **options: Any) -> None:
        RequestHandler.write_error(self, status_code, **options)


def _words(handler: RequestHandler) -> Query:
    return Query({name: handler.get_query_argument(name, strip=False) for name in handler.request.query_arguments})


def _contents(site: Site, query: Query) -> Contents:
    """Return the contents of the revision that is asked for, those of now if none is; 410 if they are forgotten."""
    if not query.text("of", ""):
        return site.board.contents
    found = site.facts.contents(query.whole("of"))
    if found is None:
        raise HTTPError(410)
    return found


class _Data(Guarded):
    """The data of pictures: arrays as their bytes, with their shape and type as headers, or JSON."""

    async def get(self, _: str, what: str) -> None:
        if what not in DATA:
            raise HTTPError(404)
        query = _words(self)
        found = await self.or_sentence(self.site.apart(lambda: DATA[what](_contents(self.site, query), query)))
        if isinstance(found, np.ndarray):
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("X-Shape", ",".join(map(str, found.shape)))
            self.set_header("X-Type", found.dtype.name)
            await self.finish(np.ascontiguousarray(found).tobytes())
        elif found is not None:
            await self.finish(found)


class _File(Guarded):
    """Downloads: results, maps with their scale, the points in space."""

    async def get(self, _: str, what: str) -> None:
        query, site = _words(self), self.site
        work: Awaitable[tuple[bytes, str]]
        if what == "space":
            work = site.apart(_picture_in_space, site, query)
        elif what in FILES:
            work = site.apart(lambda: FILES[what](_contents(site, query), query))
        else:
            raise HTTPError(404)
        found = await self.or_sentence(work)
        if found is not None:
            content, suffix = found
            name = quote(f"{query.text('name', 'lfgpu')}{suffix}", safe="")
            self.set_header("Content-Type", "image/png" if suffix.endswith(".png") else "application/octet-stream")
            self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{name}")
            await self.finish(content)


def _picture_in_space(site: Site, query: Query) -> tuple[bytes, str]:
    tab = site.tabs.get(query.text("tab"))
    if tab is None or tab.space is None:
        raise LightFieldError("there are no points in space yet: open the tab 3D.")
    return tab.space.saved(query.text("form", "picture"))


class _Do(Guarded):
    """The actions that a page asks for."""

    def initialize(self, site: Site) -> None:
        super().initialize(site)
        self._body = bytearray()

    def data_received(self, chunk: bytes) -> None:
        self._body += chunk

    async def post(self, _: str, what: str) -> None:
        if not self.request.headers.get("Content-Type", "").startswith("application/json"):
            raise HTTPError(415)
        try:
            wish = json.loads(self._body)
        except (ValueError, RecursionError):
            raise HTTPError(400) from None
        if not isinstance(wish, dict):
            raise HTTPError(400)
        if what not in ACTIONS:
            raise HTTPError(404)

        def done() -> bool:
            ACTIONS[what](self.site.board, wish)
            return True

        if await self.or_sentence(self.site.apart(done)):
            await self.finish({})

"""The web server of the viewer: the page, its data, and what it asks for. Everything lies behind the token."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote, urlsplit

import numpy as np
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler, websocket_connect

from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.methods import preset
from lfgpu.printable import message
from lfgpu.viewer import pictures, saving
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import FINAL, QUANTITIES, Contents
from lfgpu.viewer.facts import COLOURS, Facts, fixed
from lfgpu.viewer.scene import HOST, Scene
from lfgpu.viewer.solving import Request

if TYPE_CHECKING:
    from lfgpu.viewer.space import Space

_PAGE = Path(__file__).parent / "page"
_PORTS = 1000  # that are tried if the first one is taken
_PAUSE = 0.04  # seconds between two messages about the state
_LARGEST = 2**28  # bytes of a message of the scene in space
_HOSTS = ("127.0.0.1", "localhost", "::1")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; font-src 'self'; "
    "connect-src 'self' ws:; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors http://127.0.0.1:* http://localhost:*"  # notebooks
)
_T = TypeVar("_T")


class Site:
    """The web server of a board, in a thread of its own.

    Parameters
    ----------
    board
        What it shows.
    port
        Of 127.0.0.1; the next free one if it is taken. 0 takes any.
    """

    def __init__(self, board: Board, port: int) -> None:
        self.board, self.facts = board, Facts(board)
        self.token = secrets.token_urlsafe(24)
        self.pool: Executor = ThreadPoolExecutor(4, "lfgpu-page")
        self.tabs: dict[str, Tab] = {}
        self._sockets = _bound(port)
        self.port: int = self._sockets[0].getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._stop: asyncio.Event | None = None
        self._ready = threading.Event()
        logging.getLogger("tornado").addHandler(logging.NullHandler())  # else nonsense from others is on the terminal
        self._thread = threading.Thread(target=self._run, name="lfgpu-viewer", daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Close all tabs and free the port."""
        if self._stop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10.0)

    def call_soon(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Call something in the thread of the server; from any thread."""
        try:
            self._loop.call_soon_threadsafe(work, *arguments)
        except RuntimeError:
            logging.getLogger("lfgpu.viewer").debug("the server has ended")

    async def apart(self, work: Callable[..., _T], *arguments: Any) -> _T:
        """Do work in another thread, so that the server goes on answering."""
        return await asyncio.get_running_loop().run_in_executor(self.pool, work, *arguments)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self.pool.shutdown(wait=False, cancel_futures=True)
            self._loop.close()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        options = {"site": self}
        application = Application(
            [
                (r"/([^/?]+)/data/(\w+)", _Data, options),
                (r"/([^/?]+)/file/(\w+)", _File, options),
                (r"/([^/?]+)/do/(\w+)", _Do, options),
                (r"/([^/?]+)/tab", Tab, options),
                (r"/([^/?]+)/space/([\w-]+)/?(.*)", _InSpace, options),
                (r"/([^/?]+)/(.*)", _Page, {**options, "path": str(_PAGE), "default_filename": "index.html"}),
            ],
            default_handler_class=_Nothing,
            default_handler_args=options,
            log_function=lambda _: None,
            websocket_ping_interval=20,
            websocket_max_message_size=_LARGEST,
        )
        server = HTTPServer(application)
        server.add_sockets(self._sockets)
        end = self.board.listen(lambda: self.call_soon(self._tell))
        self._ready.set()
        await self._stop.wait()
        end()
        server.stop()
        for tab in list(self.tabs.values()):
            tab.close(1001, "the viewer has ended")
            tab.on_close()
        await asyncio.sleep(0.05)  # for the messages that say so
        await server.close_all_connections()

    def _tell(self) -> None:
        for tab in self.tabs.values():
            tab.wake()


def _bound(port: int) -> list[socket.socket]:
    for attempt in range(port, port + _PORTS):
        try:
            return bind_sockets(attempt, HOST, socket.AF_INET)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES) or attempt >= 65535:
                raise LightFieldError(
                    f"port {attempt} cannot be used: {error.strerror}; give another --port."
                ) from None
    raise LightFieldError(f"ports {port} to {port + _PORTS - 1} are taken; give another --port.")


# --- who may ask ---


class _Guarded(RequestHandler):
    """Answers only who knows the token, by a name of this machine, and no pages of other sites."""

    site: Site

    def initialize(self, site: Site) -> None:
        self.site = site

    async def prepare(self) -> None:
        given = (self.path_args or [""])[0] or ""
        if not secrets.compare_digest(given.encode(), self.site.token.encode()):
            raise HTTPError(403, reason="The address of the page has a token; see lfgpu view")
        if urlsplit(f"//{self.request.host}").hostname not in _HOSTS:
            raise HTTPError(403, reason="The viewer answers to localhost only")
        origin = self.request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != self.request.host:
            raise HTTPError(403, reason="Pages of other sites are not answered")

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
        if not isinstance(value, LfgpuError | HTTPError | WebSocketClosedError):
            logging.getLogger("lfgpu.viewer").error("a page could not be answered", exc_info=(typ, value, tb))

    async def _or_sentence(self, work: Awaitable[_T]) -> _T | None:
        """The result of some work; None if it failed with a sentence, which was sent."""
        try:
            return await work
        except LfgpuError as error:
            self.set_status(400)
            self.write_error(400, exc_info=(type(error), error, None))
            return None


class _Nothing(_Guarded):
    """Everything without a token."""

    async def prepare(self) -> None:
        raise HTTPError(403, reason="The address of the page has a token; see lfgpu view")


class _Page(_Guarded, StaticFileHandler):
    """The files of the page."""

    def initialize(self, site: Site, path: str, default_filename: str) -> None:  # type: ignore[override]
        _Guarded.initialize(self, site)
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


# --- data ---


class _Query:
    """The arguments of a request, of their types."""

    def __init__(self, handler: RequestHandler) -> None:
        self._handler = handler

    def text(self, name: str, default: str | None = None) -> str:
        found = self._handler.get_query_argument(name, default, strip=False)
        if found is None:
            raise LightFieldError(f"the argument {name} is missing.")
        return found

    def number(self, name: str, default: float | None = None) -> float:
        text = self.text(name, None if default is None else str(default))
        try:
            found = float(text)
        except ValueError:
            found = float("nan")
        if not np.isfinite(found):
            raise LightFieldError(f"{name} must be a number, not {text!r}.")
        return found

    def whole(self, name: str, default: int | None = None) -> int:
        return int(np.clip(self.number(name, default), -(2**31), 2**31))


def _lf(contents: Contents) -> Any:
    if contents.lf is None:
        raise LightFieldError("there is no light field.")
    return contents.lf


def _view(contents: Contents, query: _Query) -> Any:
    at = (query.whole(name) for name in ("index", "level", "column", "row"))
    return pictures.view_tile(_lf(contents), *at)


def _map(contents: Contents, query: _Query) -> Any:
    name, kind = query.text("result"), query.text("kind")
    values = contents.map(name, kind, query.text("stage", FINAL))
    if values is None:
        raise LightFieldError(f"there is no {kind} of {name!r}.")
    return pictures.map_tile(values, *(query.whole(name) for name in ("level", "column", "row")))


def _epi(contents: Contents, query: _Query) -> Any:
    return pictures.epi(_lf(contents), query.text("along"), query.whole("at"))


def _thumbnails(contents: Contents, _: _Query) -> Any:
    return pictures.thumbnails(_lf(contents))


def _refocused(contents: Contents, query: _Query) -> Any:
    level = min(max(query.whole("level"), 0), 8)
    return pictures.refocused(_lf(contents), query.number("disparity"), query.number("aperture"), level)


def _sharp(contents: Contents, query: _Query) -> Any:
    level = min(max(query.whole("level"), 0), 8)
    return pictures.sharp(contents, query.text("result"), query.text("stage", FINAL), level)


def _at(contents: Contents, query: _Query) -> Any:
    """The pixel of the reference view that a pixel of a view shows, and the values of two maps there."""
    if contents.size is None:
        return {"pixel": None, "values": {}, "other": {}}
    name, stage = query.text("result", ""), query.text("stage", FINAL)
    x, y = query.number("x"), query.number("y")
    index = query.whole("index", -1)
    if index >= 0:
        found = pictures.in_reference(contents, name, stage, index, x, y)
    else:
        height, width = contents.size
        found = int(np.clip(x, 0, width - 1)), int(np.clip(y, 0, height - 1))
    if found is None:
        return {"pixel": None, "values": {}, "other": {}}
    return {
        "pixel": found,
        "values": pictures.values_at(contents, name, stage, *found),
        "other": pictures.values_at(contents, query.text("other", ""), FINAL, *found),
    }


_DATA: dict[str, Callable[[Contents, _Query], Any]] = {
    "view": _view,
    "map": _map,
    "epi": _epi,
    "thumbnails": _thumbnails,
    "refocused": _refocused,
    "sharp": _sharp,
    "at": _at,
    "fixed": lambda *_: fixed(),
}


class _Data(_Guarded):
    """What the page draws: arrays as their bytes, with their shape and type as headers, or JSON."""

    async def get(self, _: str, what: str) -> None:
        if what not in _DATA:
            raise HTTPError(404)
        found = await self._or_sentence(self.site.apart(_DATA[what], self.site.board.contents, _Query(self)))
        if isinstance(found, np.ndarray):
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("X-Shape", ",".join(map(str, found.shape)))
            self.set_header("X-Type", found.dtype.name)
            await self.finish(np.ascontiguousarray(found).tobytes())
        elif found is not None:
            await self.finish(found)


class _File(_Guarded):
    """Downloads: results, maps with their scale, the points in space."""

    async def get(self, _: str, what: str) -> None:
        query, contents, site = _Query(self), self.site.board.contents, self.site
        work: Awaitable[bytes]
        suffix = ".png"
        try:
            match what:
                case "result":
                    suffix = query.text("suffix")
                    work = site.apart(
                        saving.saved, contents, query.text("result"), query.text("stage", FINAL), suffix
                    )  # fmt: skip
                case "figure":
                    kind, colours = query.text("kind"), query.text("colours")
                    if kind not in QUANTITIES or colours not in COLOURS:
                        raise LightFieldError(f"there is no {kind!r}, or no colours {colours!r}.")
                    limits = query.number("low"), query.number("high")
                    name, stage = query.text("result"), query.text("stage", FINAL)

                    def draw() -> bytes:
                        return saving.figure(contents, name, kind, stage, colours=colours, limits=limits)

                    work = site.apart(draw)
                case "space":
                    tab = site.tabs.get(query.text("tab"))
                    if tab is None or tab.space is None:
                        raise LightFieldError("there are no points in space yet: open the tab 3D.")
                    work = site.apart(tab.space.picture)
                case _:
                    raise HTTPError(404)
        except LfgpuError as error:
            self.set_status(400)
            self.write_error(400, exc_info=(type(error), error, None))
            return
        found = await self._or_sentence(work)
        if found is not None:
            self.set_header("Content-Type", "image/png" if suffix == ".png" else "application/octet-stream")
            name = f"{query.text('name', 'lfgpu')}{suffix}"
            self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quote(name, safe='')}")
            await self.finish(found)


class _Do(_Guarded):
    """What the page wants to be done."""

    async def post(self, _: str, what: str) -> None:
        if not self.request.headers.get("Content-Type", "").startswith("application/json"):
            raise HTTPError(415)
        try:
            wish = json.loads(self.request.body)
            if not isinstance(wish, dict):
                raise ValueError("not an object")
        except ValueError:
            raise HTTPError(400) from None
        work = {"open": self._open, "estimate": self._estimate, "stop": self._halt, "switch": self._switch}.get(what)
        if work is None:
            raise HTTPError(404)
        if await self._or_sentence(self.site.apart(work, wish)) is not None:
            await self.finish({})

    def _open(self, wish: dict[str, Any]) -> bool:
        path = str(wish.get("path", "")).strip()
        if not path:
            raise LightFieldError("type the path of a light field, or of what lfgpu depth wrote.")
        try:
            self.site.board.open_from_page(Path(path).expanduser())
        except (OSError, RuntimeError, ValueError) as error:
            raise LightFieldError(f"{path} cannot be opened: {error}.") from None
        return True

    def _estimate(self, wish: dict[str, Any]) -> bool:
        board, values, bounds = self.site.board, wish.get("values") or {}, wish.get("range")
        contents = board.contents
        if contents.lf is None:
            raise LightFieldError("a map alone cannot be estimated again: open the light field that it is of.")
        if not isinstance(values, dict) or not (bounds is None or _is_pair(bounds)):
            raise LightFieldError("the range must be two numbers, from small to large.")
        chosen = str(wish.get("preset", ""))
        config = preset(chosen).with_values({str(key): value for key, value in values.items()})
        name = str(wish.get("name") or "").strip()[:200] or chosen
        found = None if bounds is None else (float(bounds[0]), float(bounds[1]))
        if not board.solver.start(Request(contents.lf, config, found, name, contents.frame)):
            raise LightFieldError("an estimate is being made already; wait for it, or press Stop.")
        return True

    def _halt(self, _: dict[str, Any]) -> bool:
        self.site.board.solver.stop()
        return True

    def _switch(self, wish: dict[str, Any]) -> bool:
        self.site.board.switch(str(wish.get("name")), bool(wish.get("on")))
        return True


def _is_pair(values: object) -> bool:
    return (
        isinstance(values, list)
        and len(values) == 2
        and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    )


# --- tabs ---


class Tab(_Guarded, WebSocketHandler):
    """One tab of a browser: it is told of all changes, and has a scene in space of its own."""

    space: Space | None = None

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked it

    async def open(self, *_: str, **__: str) -> None:
        self.identity = secrets.token_urlsafe(12)
        self._changed, self._gone = asyncio.Event(), False
        self._starting: asyncio.Task[None] | None = None
        self._scene: Scene | None = None
        self.site.tabs[self.identity] = self
        self._changed.set()
        self._writing = asyncio.ensure_future(self._write_forever())

    def wake(self) -> None:
        """Tell the page what has changed, soon."""
        self._changed.set()

    async def _write_forever(self) -> None:
        try:
            await self.write_message({"tab": self.identity})
            while not self._gone:
                await self._changed.wait()
                self._changed.clear()
                state = await self.site.apart(self.site.facts.now)
                await self.write_message({"state": state})
                if self.space is not None:
                    self.space.refresh()
                await asyncio.sleep(_PAUSE)
        except (WebSocketClosedError, RuntimeError):
            return
        except Exception:
            logging.getLogger("lfgpu.viewer").exception("a page could not be told the state")

    async def on_message(self, text: str | bytes) -> None:
        """A scene that the page wants to see in space, or the wish to start over there."""
        try:
            wish = json.loads(text)
            if wish.get("startOver") and self.space is not None:
                self.space.start_over()
            scene = wish.get("scene")
            self._scene = Scene.of(scene) if scene is not None else self._scene
        except (ValueError, AttributeError, LfgpuError):
            return
        if self._scene is None:
            return
        if self.space is not None:
            self.space.show(self._scene)
        elif self._starting is None:
            self._starting = asyncio.ensure_future(self._start())

    async def _start(self) -> None:
        """Start the scene in space; viser takes a moment."""
        try:
            space = await self.site.apart(self._new_space)
        except Exception as error:
            logging.getLogger("lfgpu.viewer").exception("the scene in space could not be started")
            await self.write_message({"message": f"The points in space cannot be shown: {error}."})
            return
        if self._gone:
            space.close()
            return
        self.space = space
        assert self._scene is not None
        space.show(self._scene)
        await self.write_message({"space": True})

    def _new_space(self) -> Space:
        from lfgpu.viewer.space import Space

        return Space(self.site.board, self._picked)

    def _picked(self, x: int, y: int) -> None:
        self.site.call_soon(self._send, {"picked": [x, y]})

    def _send(self, words: dict[str, Any]) -> None:
        if not self._gone:
            self.write_message(words)

    def on_close(self) -> None:
        if getattr(self, "_gone", True):
            return
        self._gone = True
        self._changed.set()
        self.site.tabs.pop(self.identity, None)
        if self.space is not None:
            threading.Thread(target=self.space.close, daemon=True).start()


class _InSpace(_Guarded, WebSocketHandler):
    """The page and the messages of viser, handed on, so that one address and one token hold for all."""

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked it

    def _address(self, scheme: str, tab: str, rest: str) -> str:
        found = self.site.tabs.get(tab)
        if found is None or found.space is None:
            raise HTTPError(404)
        return f"{scheme}://{HOST}:{found.space.port}/{found.space.token}/{rest}"

    async def get(self, token: str, tab: str, rest: str) -> None:
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(token, tab, rest)
            return
        answer = await AsyncHTTPClient().fetch(self._address("http", tab, quote(rest)), raise_error=False)
        self.set_status(answer.code)
        self.set_header("Content-Type", answer.headers.get("Content-Type", "application/octet-stream"))
        await self.finish(answer.body)

    def select_subprotocol(self, subprotocols: list[str]) -> str | None:
        return next((offered for offered in subprotocols if offered.startswith("viser-")), None)

    async def open(self, _: str, tab: str, rest: str) -> None:
        offered = [self.selected_subprotocol] if self.selected_subprotocol else None
        self._there = await websocket_connect(
            HTTPRequest(self._address("ws", tab, rest)),
            subprotocols=offered,
            max_message_size=_LARGEST,
        )
        self._reading = asyncio.ensure_future(self._read_forever())

    async def _read_forever(self) -> None:
        try:
            while (words := await self._there.read_message()) is not None:
                await self.write_message(words, binary=isinstance(words, bytes))
        except WebSocketClosedError:
            return
        self.close()

    async def on_message(self, words: str | bytes) -> None:
        if hasattr(self, "_there"):
            try:
                await self._there.write_message(words, binary=isinstance(words, bytes))
            except WebSocketClosedError:
                self.close()

    def on_close(self) -> None:
        if hasattr(self, "_there"):
            self._there.close()

"""The tabs of a browser: each is told of all changes, and has a scene in space of its own."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import threading
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler, websocket_connect

from lfgpu.errors import LfgpuError
from lfgpu.viewer.contents import Contents
from lfgpu.viewer.guard import Guarded
from lfgpu.viewer.late import import_all
from lfgpu.viewer.place import HOST
from lfgpu.viewer.scene import Scene

if TYPE_CHECKING:
    from lfgpu.viewer.space import Space

LARGEST = 2**28
"""Bytes of a message of the scene in space."""

_PAUSE = 0.04  # seconds between two messages about the state
_PATIENCE = 3.0  # seconds: a page that has not taken a state until then is told the next one


class Tab(Guarded, WebSocketHandler):
    """One tab of a browser: it is told of all changes, and has a scene in space of its own."""

    space: Space | None = None

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked it

    async def open(self, *_: str, **__: str) -> None:
        self.identity = secrets.token_urlsafe(12)
        self._changed, self._taken, self._gone = asyncio.Event(), asyncio.Event(), False
        self._told = 0  # the revision of the state that it was told last
        self._kept = deque[Contents](maxlen=2)  # what the page shows, and what it was told last
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
                state, contents = await self.site.apart(self.site.facts.newest)
                if not self._kept or contents is not self._kept[-1]:
                    self._kept.append(contents)
                self._taken.clear()
                self._told = state["revision"]
                await self.write_message({"state": state})
                with suppress(asyncio.TimeoutError):  # pages in the background may not answer
                    await asyncio.wait_for(self._taken.wait(), _PATIENCE)
                self.site.prepare()  # while people look at the first pictures
                if self.space is not None:
                    self.space.refresh()
                await asyncio.sleep(_PAUSE)
        except (WebSocketClosedError, RuntimeError):
            return
        except Exception:
            logging.getLogger("lfgpu.viewer").exception("a page could not be told the state")

    async def on_message(self, text: str | bytes) -> None:
        """Take a scene that the page wants to see in space, or the wish to start over there."""
        try:
            wish = json.loads(text)
            if wish.get("taken") == self._told:
                self._taken.set()
            if wish.keys() <= {"taken"}:
                return
            if wish.get("startOver") and self.space is not None:
                self.space.start_over()
            scene = wish.get("scene")
            self._scene = Scene.of(scene) if scene is not None else self._scene
        except (ValueError, AttributeError, RecursionError, LfgpuError):
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
        import_all()
        from lfgpu.viewer.space import Space

        return Space(self.site.board, lambda x, y: self.site.call_soon(self.tell, {"picked": [x, y]}))

    def tell(self, words: dict[str, Any]) -> None:
        """Send words to the page, if it is still there."""
        if not self._gone:
            self.write_message(words)

    def on_close(self) -> None:
        if getattr(self, "_gone", True):
            return
        self._gone = True
        self._changed.set()
        self._taken.set()
        self.site.tabs.pop(self.identity, None)
        if self.space is not None:
            threading.Thread(target=self.space.close, daemon=True).start()


class InSpace(Guarded, WebSocketHandler):
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
            max_message_size=LARGEST,
        )
        if (page := self.site.tabs.get(tab)) is not None:
            page.tell({"joined": True})
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

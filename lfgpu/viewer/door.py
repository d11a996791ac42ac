"""Door of the server: connections that have not shown the token make room for new ones."""

import logging
import socket

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream

_STRANGERS = 16  # connections that have not shown the token; browsers open six at a time, and show it at once
_AT_ONCE = 4  # connections that are taken before those that are there are heard: fewer than may stay
_REST = 0.5  # seconds without new connections, if the process can open nothing more


class Door:
    """Listening socket of a server, which is never full of connections that say nothing."""

    def __init__(self, server: HTTPServer, listening: socket.socket) -> None:
        self._server, self._socket, self._loop = server, listening, IOLoop.current()
        self._strangers: list[IOStream] = []
        self._is_closed, self._has_said = False, False
        self._open()

    def know(self, stream: IOStream) -> None:
        """Keep a connection that has shown the token, however many others come."""
        if stream in self._strangers:
            self._strangers.remove(stream)

    def close(self) -> None:
        """Take no more connections, and free the port."""
        self._is_closed = True
        self._loop.remove_handler(self._socket)
        self._socket.close()

    def _open(self) -> None:
        if not self._is_closed:
            self._loop.add_handler(self._socket, lambda *_: self._take(), IOLoop.READ)

    def _take(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                connection, address = self._socket.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:  # the process can open nothing more
                self._drop_oldest(error.strerror or "no room")
                self._loop.remove_handler(self._socket)
                self._loop.call_later(_REST, self._open)
                return
            self._strangers = [stream for stream in self._strangers if not stream.closed()]
            if len(self._strangers) == _STRANGERS:
                self._drop_oldest("too many connections at a time")
            stream = IOStream(connection)
            self._strangers.append(stream)
            self._server.handle_stream(stream, address)

    def _drop_oldest(self, reason: str) -> None:
        if not self._has_said:
            self._has_said = True
            logging.getLogger("lfgpu.viewer").warning("connections without the token are closed: %s", reason)
        if self._strangers:
            self._strangers.pop(0).close()

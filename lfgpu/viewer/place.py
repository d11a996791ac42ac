"""Address of a page: a port of this machine and a token. The module imports little, so that the address is known at
once.
"""

import errno
import importlib.util
import secrets
import socket

from lfgpu.errors import LightFieldError

HOST = "127.0.0.1"
"""The viewer is reachable from this machine only."""

_PORTS = 1000  # that are tried if the first one is taken
_LAST = 65535
_WAITING = 128  # connections that wait until they are answered


def check_installed() -> None:
    """Raise LightFieldError if what the viewer needs is not installed."""
    missing = [name for name in ("tornado", "viser") if importlib.util.find_spec(name) is None]
    if missing:
        from lfgpu.io.damage import how_to_install

        raise LightFieldError(f"the viewer needs {' and '.join(missing)}; {how_to_install('viewer')}.")


class Place:
    """A port of 127.0.0.1 that is taken, the next free one if need be, and a token. Who connects early waits."""

    def __init__(self, port: int) -> None:
        self.socket = _bound(port)
        self.port: int = self.socket.getsockname()[1]
        self.token = secrets.token_urlsafe(24)
        """The first part of every path."""

    @property
    def url(self) -> str:
        """The address of the page; whoever knows it can use the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"


def _bound(port: int) -> socket.socket:
    if not 0 <= port <= _LAST:
        raise LightFieldError(f"there is no port {port}; give one from 0 to {_LAST} as --port.")
    for attempt in range(port, min(port + _PORTS, _LAST + 1)):
        taken = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.setblocking(False)
        try:
            taken.bind((HOST, attempt))
            taken.listen(_WAITING)
        except OSError as error:
            taken.close()
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise LightFieldError(
                    f"port {attempt} cannot be used: {error.strerror}; give another --port."
                ) from None
            continue
        return taken
    raise LightFieldError(f"ports {port} to {min(port + _PORTS - 1, _LAST)} are taken; give another --port.")

"""Progress of readers: a few words for each step, to whoever listens in the same thread."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_listener: ContextVar[Callable[[str], None] | None] = ContextVar("lfgpu_reading", default=None)


def listener() -> Callable[[str], None]:
    """Return what takes the words of readers in this thread; it may be called from others, too."""
    return _listener.get() or (lambda step: None)


def say(step: str) -> None:
    """Say what begins, in a few words, to the listener of this thread."""
    listener()(step)


@contextmanager
def heard_by(listener: Callable[[str], None]) -> Iterator[None]:
    """Let `listener` hear what readers say in this thread while the block runs."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)

"""Progress of readers: a few words for each step, to whoever listens in the same thread."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

T = TypeVar("T")

_listener: ContextVar[Callable[[str], None] | None] = ContextVar("lfgpu_reading", default=None)


def listener() -> Callable[[str], None]:
    """Return what takes the words of readers in this thread; it may be called from others, too."""
    return _listener.get() or (lambda step: None)


def say(step: str) -> None:
    """Say what begins, in a few words, to the listener of this thread."""
    listener()(step)


def heard_by(listener: Callable[[str], None]) -> AbstractContextManager[object]:
    """Let `listener` hear what readers say in this thread while the block runs."""
    return within(_listener, listener)


@contextmanager
def within(variable: ContextVar[Any], value: T) -> Iterator[T]:
    """Give a variable of this thread a value while the block runs."""
    before = variable.set(value)
    try:
        yield value
    finally:
        variable.reset(before)

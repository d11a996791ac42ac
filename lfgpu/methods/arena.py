"""The memory of a plan: named buffers that stay, and scratch that passes share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfgpu.contract import Alignment, Array, Device, PlaneSweep, Scalar

_MOST_NUMBERS = 64  # of a plan

_Kind = tuple[tuple[int, ...], str]


class Arena:
    """Buffers on a device.

    A named buffer keeps what is written into it. Who asks for the name of a buffer again gets the same one. Scratch is
    lent to a pass while the pass is constructed, and the pass may use it during its calls only. Passes whose scopes
    follow one another share it. A pass that calls another pass while its scratch holds something constructs that pass
    inside its own scope: nested scopes share nothing. On a CPU, scratch may lie in that of another kind, if it fills a
    quarter of it or more.

    If it `follows`, its numbers are scalars on the device where the backend has these, and `follow` changes them.
    """

    def __init__(self, device: Device, *, follows: bool = False) -> None:
        self.device, self.kernels = device, device.kernels
        self.changing = device.kernels.changing if follows else None
        self._numbers = None if self.changing is None else self.changing.numbers(_MOST_NUMBERS, device.name)
        self._values: list[Callable[[], float]] = []
        self._named: dict[str, tuple[_Kind, Array]] = {}
        self._free: list[tuple[_Kind, Array]] = []

    def field(self, name: str, shape: Sequence[int]) -> Array:
        """Return the field of a name; it holds zeros when it is new."""
        return self._kept(name, (tuple(shape), ""))

    def image(self, name: str, shape: Sequence[int], stored: DTypeLike = np.float32) -> Array:
        """Return the image [..., c] of a name, stored in the NumPy type `stored`; it holds zeros when it is new."""
        return self._kept(name, (tuple(shape), np.dtype(stored).name))

    def constant(self, name: str, values: NDArray[Any]) -> Array:
        """Return the field of a name, which holds `values` when it is new; nothing may write into it."""
        kind = (values.shape, "")
        if name not in self._named:
            self._named[name] = kind, self.device.field(values)
        return self._kept(name, kind)

    def number(self, value: Callable[[], float]) -> float | Scalar:
        """Return a number that follows what was measured, which `value` computes."""
        if self._numbers is None:
            return value()
        self._values.append(value)
        return self._numbers.scalars[len(self._values) - 1]

    def follow(self) -> None:
        """Compute all numbers anew."""
        if self._numbers is not None:
            self._numbers.change([value() for value in self._values])

    @contextmanager
    def scratch(self) -> Iterator[Scratch]:
        """Begin a scope in which scratch is lent; scopes that follow are lent the same buffers."""
        scope: list[tuple[_Kind, Array]] = []
        try:
            yield Scratch(self, scope)
        finally:
            self._free += scope

    def lend(self, kind: _Kind, scope: list[tuple[_Kind, Array]]) -> Array:
        """Lend a free buffer, or a new one, to a scope."""
        size = _bytes(kind)
        for place, (other, home) in sorted(enumerate(self._free), key=lambda free: (free[1][0] != kind, -free[0])):
            buffer = home if other == kind else None
            if buffer is None and not self.device.is_gpu and size <= _bytes(other) <= 4 * size:
                buffer = self.kernels.within(home, kind[0], np.dtype(kind[1]).type if kind[1] else None)
            if buffer is not None:
                scope.append(self._free.pop(place))
                return buffer
        scope.append((kind, self._made(kind)))
        return scope[-1][1]

    def _kept(self, name: str, kind: _Kind) -> Array:
        if name not in self._named:
            self._named[name] = kind, self._made(kind)
        there, buffer = self._named[name]
        assert there == kind, f"the buffer {name!r} is {there}, not {kind}"
        return buffer

    def _made(self, kind: _Kind) -> Array:
        shape, stored = kind
        return self.device.zeros_image(shape, np.dtype(stored).type) if stored else self.device.zeros(shape)


def _bytes(kind: _Kind) -> int:
    shape, stored = kind
    return math.prod(shape) * np.dtype(stored or np.float32).itemsize


class Scratch:
    """Buffers that a pass may use during its calls; their contents are arbitrary before each call."""

    def __init__(self, arena: Arena, scope: list[tuple[_Kind, Array]]) -> None:
        self._arena, self._scope = arena, scope

    def field(self, shape: Sequence[int]) -> Array:
        """Lend a field."""
        return self._arena.lend((tuple(shape), ""), self._scope)

    def image(self, shape: Sequence[int], stored: DTypeLike = np.float32) -> Array:
        """Lend an image [..., c] that is stored in the NumPy type `stored`."""
        return self._arena.lend((tuple(shape), np.dtype(stored).name), self._scope)

    def room(self, plan: PlaneSweep | Alignment, stored: DTypeLike) -> Array | None:
        """Lend what a plan needs to load views that are stored in a NumPy type; None if it needs nothing."""
        floats = plan.room(stored)
        return self.field((floats,)) if floats else None

    def fields(self, count: int, shape: Sequence[int]) -> tuple[Array, ...]:
        """Lend several fields of one shape."""
        return tuple(self.field(shape) for _ in range(count))

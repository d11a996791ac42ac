"""Vector operations on fields of one shape, and numbers that are made of them."""

from __future__ import annotations

from typing import Protocol

from lfgpu.contract.arrays import Array, Scalar


class Vectors(Protocol):
    """Vector operations of solvers."""

    def dot(self, a: Array, b: Array, product_out: Scalar) -> None:
        """Compute the inner product, accumulated in float64."""

    def ratio(self, numerator: Scalar, denominator: Scalar, ratio_out: Scalar, *, factor: float = 1.0) -> None:
        """Compute factor * numerator / denominator; 0 where the denominator is 0. `ratio_out` may be one of them."""

    def copy(self, source: Array, target_out: Array) -> None:
        """Copy a field to a field, or a scalar to a scalar."""

    def axpby(self, alpha: float | Scalar, x: Array, beta: float | Scalar, y: Array, y_out: Array) -> None:
        """Compute y_out = alpha x + beta y; `y_out` may be `x` or `y`. Scalars x, y and y_out take plain numbers."""

    def multiply(self, x: Array, y: Array, product_out: Array) -> None:
        """Multiply element by element; `product_out` may be `x` or `y`."""

    def divide(self, x: Array, y: Array, quotient_out: Array) -> None:
        """Divide element by element, 0 where y is 0; `quotient_out` may be `x` or `y`."""

    def fill(self, value: float | Scalar, x_out: Array) -> None:
        """Set each element to `value`."""

    def select(self, condition: Array, x: Array, y: Array, chosen_out: Array) -> None:
        """Take x where condition > 0, else y, element by element; `chosen_out` may be any of them."""

    def threshold(self, x: Array, threshold: float, x_out: Array) -> None:
        """Keep x where x >= threshold, else 0; `x_out` may be `x`."""

    def clamp(self, x: Array, low: float, high: float, x_out: Array) -> None:
        """Move each element into [low, high]; `x_out` may be `x`."""

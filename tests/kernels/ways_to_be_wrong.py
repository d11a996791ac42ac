"""Ways to be wrong: each turns a right operation into a wrong one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

# --- ways to be wrong: each turns a right operation into a wrong one ---


def after(change: Callable[[np.ndarray], Any], *outputs: str) -> Callable[..., Any]:
    """Outputs named `outputs` (or the last argument) are changed in place afterwards."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            result = right(*args, **options)
            for output in [options[name] for name in outputs] or [args[-1]]:
                change(output)
            return result

        return wrong

    return broken


def before(change: Callable[[list[Any], dict[str, Any]], None]) -> Callable[..., Any]:
    """Arguments are changed before the operation sees them; `change` gets (positional, keyword)."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            positional = list(args)
            change(positional, options)
            return right(*positional, **options)

        return wrong

    return broken


def planned(change: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., Any]:
    """The plan that an operation makes is turned into a wrong one."""
    return lambda right: lambda *args, **options: change(right(*args, **options))


def accumulating(*outputs: str) -> Callable[..., Any]:
    """Adds to what the outputs held instead of overwriting it."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> None:
            held = [options[name].copy() for name in outputs]
            right(*args, **options)
            for name, old in zip(outputs, held, strict=True):
                options[name] += old

        return wrong

    return broken


def argument(index: int, change: Callable[[Any], Any]) -> Callable[..., Any]:
    def replace(args: list[Any], options: dict[str, Any]) -> None:
        args[index] = change(args[index])

    return before(replace)


def option(name: str, change: Callable[[Any], Any], *, absent: bool = False) -> Callable[..., Any]:
    """A keyword argument is another one; `absent`: it may be missing."""
    return before(lambda args, options: options.update({name: change(options.get(name) if absent else options[name])}))


def rewritten(module: ModuleType, old: str, new: str) -> Callable[..., Any]:
    """The operation as the reference's module has it once a piece of its text is another one."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        text = inspect.getsource(module)
        if text.count(old) != 1:  # not an AssertionError, as those are what faults are caught by
            raise ValueError(f"{old!r} does not stand once in {module.__name__}: this fault needs another place.")
        names = dict(vars(module))
        exec(compile(text.replace(old, new), str(module.__file__), "exec"), names)

        def wrong(*args: Any, **options: Any) -> None:
            with np.errstate(all="ignore"):
                names[right.__name__](*args, **options)

        return wrong

    return broken


def with_another(module: Any, name: str, change: Callable[[Any], Any]) -> Callable[..., Any]:
    """Something else under a name of the reference's module."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> None:
            with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
                patch.setattr(module, name, change(getattr(module, name)))
                right(*args, **options)

        return wrong

    return broken


def scaled(factor: float) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output *= factor

    return change


def zeroed(where: Any) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output[where] = 0

    return change


def noisy(output: np.ndarray) -> None:
    output += np.random.default_rng().normal(size=output.shape) * 1e-13


def one_off(output: np.ndarray) -> None:
    """One weight in the middle is wrong by one part in a thousand of the largest."""
    output[tuple(side // 2 for side in output.shape)] += 1e-3 * np.abs(output).max()


def skewed(weights: np.ndarray) -> np.ndarray:
    """Weights that lie one column to the right of their pixels."""
    return np.roll(weights, 1, axis=2)


def mirrored(output: np.ndarray) -> None:
    output[:] = output[:, ::-1].copy()


def changing_its_input(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(x: Any, *args: Any, **options: Any) -> Any:
        result = right(x, *args, **options)
        x += 1
        return result

    return wrong


def swapped(offsets: np.ndarray) -> np.ndarray:
    return offsets[:, ::-1].copy()


def method(name: str, broken: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., Any]:
    """Of the plan that an operation makes one method is turned into a wrong one."""

    def change(plan: Any) -> Any:
        setattr(plan, name, broken(getattr(plan, name)))
        return plan

    return planned(change)


def called(plan: Any, wrong: Callable[..., Any]) -> Any:
    """The plan with another call, and its other methods."""
    others = {name: staticmethod(getattr(plan, name, None)) for name in ("load", "curvature")}
    return type("Wrong", (), {"__call__": staticmethod(wrong), **others})()


def half_gradient(plan: Any) -> Any:
    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        plan(disparity, gradient_out, value_out)
        gradient_out *= 0.5

    return called(plan, wrong)


def remembering(plan: Any) -> Any:
    """Adds up the values of all its calls."""
    total = np.zeros(1)

    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        plan(disparity, gradient_out, value_out)
        total[:] += value_out
        value_out[:] = total

    return called(plan, wrong)


def loading_once(right: Callable[..., Any]) -> Callable[..., Any]:
    """What is loaded first is what stays."""
    loaded: list[Any] = []

    def wrong(*light_field: Any) -> None:
        loaded.append(light_field)
        right(*loaded[0])

    return wrong


def keeping_its_mask(right: Callable[..., Any]) -> Callable[..., Any]:
    """Without a mask, the one before is taken."""
    masks: list[Any] = []

    def wrong(image: Any, recorded: Any, valid: Any) -> None:
        masks.extend([] if valid is None else [valid])
        right(image, recorded, masks[-1] if masks else None)

    return wrong


def without_last_view(right: Callable[..., Any]) -> Callable[..., Any]:
    """The last view is as if it were not valid."""

    def wrong(image: Any, recorded: Any, valid: Any) -> None:
        counts = np.ones(recorded.shape[:3]) if valid is None else valid.copy()
        counts[-1] = 0
        right(image, recorded, counts)

    return wrong


def first_inputs(right: Callable[..., Any]) -> Callable[..., Any]:
    """A plan that keeps what it was first called with."""

    def plan_wrong(*args: Any, **options: Any) -> Callable[..., Any]:
        plan, seen = right(*args, **options), []

        def wrong(inputs: Any, *more: Any) -> None:
            seen.append(inputs)
            plan(seen[0], *more)

        return wrong

    return plan_wrong


def invert(output: np.ndarray) -> None:
    output[:] = 1 - output


NO_MASK = method("load", argument(2, lambda _: None))

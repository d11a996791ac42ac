"""Source of frames that a Python function yields, a grabber."""

import importlib
import inspect
import sys
from collections.abc import Iterable
from pathlib import Path

from lfgpu.errors import LightFieldError
from lfgpu.pipelines.sources.base import Frames, Options


def recognise(source: str) -> bool:
    return ":" in source and not Path(source).exists()


def frames(source: str, _: Options) -> Frames:
    """Yield the frames of module:function. The module may be in the current folder."""
    module_name, _colon, function_name = source.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        grabber = getattr(importlib.import_module(module_name.removesuffix(".py")), function_name)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise LightFieldError(f"{source} cannot be imported: {str(error).rstrip('.')}.") from error
    found = grabber() if _takes_nothing(grabber) else None
    if not isinstance(found, Iterable):
        raise LightFieldError(f"{source} must be a function without arguments that yields frames.")
    return iter(found)


def _takes_nothing(grabber: object) -> bool:
    """Tell whether an object can be called without arguments, as far as its signature is known."""
    if not callable(grabber):
        return False
    try:
        inspect.signature(grabber).bind()
    except TypeError:
        return False
    except ValueError:  # some functions in C do not say
        return True
    return True

"""Modules that are imported while something else goes on."""

from __future__ import annotations

import importlib
import threading
from contextlib import suppress


def import_meanwhile(*modules: str) -> None:
    """Import modules in a thread of its own; what is wrong with one is said to whoever needs it, who imports it again.

    Kernels work and are loaded without the interpreter lock, so that this costs no time there.
    """

    def work() -> None:
        for module in modules:
            with suppress(Exception):
                importlib.import_module(module)

    threading.Thread(target=work, name="lfgpu-import").start()

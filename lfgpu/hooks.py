"""Functions of higher rooms that results call: to save themselves, and to show themselves in notebooks.

`lfgpu/__init__.py` sets them, so that the room of results imports none of those above it.
"""

from collections.abc import Callable

save: Callable[..., None]
"""`lfgpu.io.save`."""

html: Callable[[object], str]
"""`lfgpu.reports.notebook.html`."""

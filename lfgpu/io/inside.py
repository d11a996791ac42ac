"""Facts about a file beside its views, or instead of them: for people who ask what it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Inside:
    """Facts about a file that no light field has a place for."""

    facts: tuple[tuple[str, str], ...]
    """(label, text) each, in the order of importance."""
    no_depth: str | None = None
    """A sentence that says why there is no light field in it; None if there is one."""

"""A row of the registry of methods."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lfgpu.config import Config


@dataclass(frozen=True)
class Entry:
    """A row of the registry of methods.

    Parameters
    ----------
    config
        The configuration class; its `method` is the name.
    presets
        Complete parameters by name.
    home
        Module and class of the method as `module:Class`; loaded when it is first used.
    label
        What the method does, in a few words.
    labels
        What each preset is, in a few words, by its name.
    """

    config: type[Config]
    presets: Mapping[str, Config]
    home: str
    label: str
    labels: Mapping[str, str]

"""Methods to estimate a disparity map. Each is a package here and a row of `METHODS`.

`lfgpu/methods/base.py` is their interface.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from lfgpu.config import Config, parameters, value_of
from lfgpu.errors import LightFieldError
from lfgpu.methods.matching import config as _matching
from lfgpu.methods.synthesis import config as _synthesis

if TYPE_CHECKING:
    from lfgpu.methods.base import Method


@dataclass(frozen=True)
class Entry:
    """A row of the registry of methods."""

    config: type[Config]  # the configuration class; its `method` is the name
    presets: Mapping[str, Config]  # complete parameters by name
    home: str  # module and class of the method as `module:Class`; loaded when it is first used
    label: str  # what the method does, in a few words
    labels: Mapping[str, str]  # what each preset is, in a few words, by its name


METHODS: dict[str, Entry] = {
    "matching": Entry(
        _matching.MatchingConfig,
        _matching.PRESETS,
        "lfgpu.methods.matching.method:Matching",
        "finds the surface on which the views agree, with occlusions",
        {
            "accurate": "four sweeps, three of them over all views that see a pixel",
            "fast": "two sweeps over the views in the row and column of the reference",
            "learned": "one network, trained on generated light fields, over all views",
            "surest": "two sweeps, and the map of learned; a second network chooses at each pixel",
        },
    ),
    "synthesis": Entry(
        _synthesis.SynthesisConfig,
        _synthesis.PRESETS,
        "lfgpu.methods.synthesis.method:Synthesis",
        "finds the map that predicts all views best (Sajjadi et al. 2016)",
        {
            "paper": "Sajjadi et al. 2016, for views with noise and occlusions",
            "paper-exact": "Sajjadi et al. 2016 as printed",
        },
    ),
}
"""All methods by name. A new method is a package here and a row of this table."""

PRESETS: dict[str, Config] = {name: config for entry in METHODS.values() for name, config in entry.presets.items()}
"""Complete parameters by name."""

PresetName: TypeAlias = Literal["accurate", "fast", "learned", "surest", "paper", "paper-exact"]
"""The names of `PRESETS`, for type checkers."""

DEFAULT: PresetName = "surest"
"""The preset of an estimate that names none."""


def preset(name: str) -> Config:
    """Return the parameters of a preset; raise LightFieldError if there is none of that name.

    Examples
    --------
    >>> lfgpu.methods.preset("fast").with_values({"prior.window": 11}).prior.window
    11
    """
    if name not in PRESETS:
        raise LightFieldError(f"unknown preset {name!r}; use one of {', '.join(PRESETS)}.")
    return PRESETS[name]


def configured(config: Config | str | None, weights: str | os.PathLike[str] | None = None) -> Config:
    """Return the parameters that `config` is or names, with the weights of a file of `lfgpu train`.

    None is the default preset, or "learned" with weights. LightFieldError if `config` has no network for them.
    """
    if config is None:
        config = DEFAULT if weights is None else "learned"
    found = preset(config) if isinstance(config, str) else config
    if not isinstance(found, Config):
        raise LightFieldError(
            f"config must be the name of a preset ({', '.join(PRESETS)}) or a Config, not {type(config).__name__}."
        )
    if weights is None:
        return found
    if not isinstance(found, _matching.MatchingConfig) or found.tuning.passes == "matching":
        raise LightFieldError(
            "weights are for a network, which only the presets learned and surest have; give one of them."
        )
    from lfgpu.methods.matching.learned import weights_file

    return replace(found, weights=weights_file(weights))


def nearest_preset(config: Config) -> tuple[str, frozenset[str]]:
    """Find the preset of the same method with most values in common, and the names of the parameters that differ."""
    own = dict(parameters(config))
    different = {
        name: frozenset(parameter for parameter in own if value_of(config, parameter) != value_of(other, parameter))
        for name, other in METHODS[config.method].presets.items()
    }
    return min(different.items(), key=lambda item: len(item[1]))


def method_of(config: Config | str) -> Method[Any]:
    """Make the method with parameters, or with those of a preset; raise LightFieldError if there is no such preset."""
    found = configured(config)
    module, _, name = METHODS[found.method].home.partition(":")
    method: Method[Any] = getattr(importlib.import_module(module), name)(found)
    return method

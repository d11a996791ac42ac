"""Parameters of methods: a configuration has sections, and a section has checked numbers and choices.

The configuration class of each method is in `lfgpu/methods/NAME/config.py`. Numbers that users do not set are no
parameters: a `Tuning` holds them.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, ClassVar, Self

from lfgpu.errors import LightFieldError


def number(default: float, low: float, high: float, doc: str, *, symbol: str = "", odd: bool = False) -> Any:
    """Declare a parameter that is a number from `low` to `high`: an integer if the default is one; odd if `odd`."""
    return field(default=default, metadata={"low": low, "high": high, "doc": doc, "symbol": symbol, "odd": odd})


def choice(default: str, choices: tuple[str, ...], doc: str) -> Any:
    """Declare a parameter that is one of several words."""
    return field(default=default, metadata={"choices": choices, "doc": doc, "symbol": ""})


@dataclass(frozen=True)
class Section:
    """Parameters of one stage: a frozen dataclass of fields from `number` and `choice`, whose values are checked."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value, meta = getattr(self, f.name), f.metadata
            if "choices" in meta:
                if not isinstance(value, str) or value not in meta["choices"]:
                    raise LightFieldError(f"{f.name} must be one of {', '.join(meta['choices'])}, not {value!r}.")
            elif isinstance(value, bool) or not isinstance(value, Real):
                raise LightFieldError(f"{f.name} must be a number, not {value!r}.")
            elif isinstance(f.default, int) and not isinstance(value, Integral):
                raise LightFieldError(f"{f.name} must be an integer, not {float(value):g}.")
            elif not meta["low"] <= value <= meta["high"]:
                raise LightFieldError(f"{f.name} must be from {meta['low']:g} to {meta['high']:g}, not {value:g}.")
            elif meta["odd"] and value % 2 == 0:
                raise LightFieldError(f"{f.name} must be odd, not {value:g}.")
            else:  # also a number of NumPy, which no file holds
                object.__setattr__(self, f.name, int(value) if isinstance(value, Integral) else float(value))

    def within(self, **values: float) -> Self:
        """Return a copy with some numbers changed, as far as their ranges go."""
        of = {f.name: f.metadata for f in dataclasses.fields(self)}
        return dataclasses.replace(self, **{n: min(max(v, of[n]["low"]), of[n]["high"]) for n, v in values.items()})


def tuned(value: float | str, unit: str, reason: str, *, ablation: str = "") -> Any:
    """Define a number of a `Tuning`, or the name of a rule: its unit, what it is, and why it has this value.

    `ablation` is the variant in `benchmarks/results/ablation.json` that shows what it is worth; "" if none does.
    """
    return field(default=value, metadata={"unit": unit, "reason": reason, "ablation": ablation})


@dataclass(frozen=True)
class Tuning:
    """Numbers of a method that users do not set, by section; `name` is theirs in files, "" if they were changed."""

    name: str

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a copy without a name and with some numbers, by `section.number`, changed: for experiments only."""
        tuning = dataclasses.replace(self, name="")
        for name, value in values.items():
            section, _, number_ = name.partition(".")
            changed = dataclasses.replace(getattr(tuning, section), **{number_: value}) if number_ else value
            tuning = dataclasses.replace(tuning, **{section: changed})
        return tuning


@dataclass(frozen=True)
class Config:
    """All parameters of one method. This is the base class, without parameters, of `MatchingConfig` and the others.

    The fields of a derived class are sections, at most one `Tuning`, and names of files. A parameter is named
    `section.parameter`.
    """

    method: ClassVar[str] = ""
    """Name of the method that reads these parameters."""

    renamed: ClassVar[Mapping[str, str]] = {}
    """Old names of sections and parameters, with their new names."""

    fixed: ClassVar[frozenset[str]] = frozenset()
    """Old names of parameters that are numbers of a `Tuning` now."""

    known: ClassVar[dict[str, type[Config]]] = {}
    """The configuration classes of all methods, by the name of the method."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        Config.known[cls.method] = cls

    def __post_init__(self) -> None:
        if type(self) is Config:
            kinds = ", ".join(sorted(kind.__name__ for kind in self.known.values()))
            raise LightFieldError(f"Config itself has no parameters; use a preset, or one of {kinds}.")

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with some parameters changed.

        Parameters
        ----------
        values
            New values by name, `section.parameter`. Numbers may be given as text.

        Raises
        ------
        LightFieldError
            If a value is out of range, or the method has no parameter of that name.
        """
        if not isinstance(values, Mapping):
            raise LightFieldError(f"values must be a dictionary of parameters by name, not {values!r:.60}.")
        config, there = self, dict(parameters(self))
        for name, value in values.items():
            if name not in there:
                raise LightFieldError(self._unknown(str(name)))
            if isinstance(value, str) and "choices" not in there[name].metadata:
                try:
                    value = float(value)
                except ValueError as error:
                    raise LightFieldError(f"{name} must be a number, not {value!r}.") from error
                if value.is_integer() and isinstance(there[name].default, int):
                    value = int(value)
            section, parameter = name.split(".")
            try:
                changed = dataclasses.replace(getattr(config, section), **{parameter: value})
            except LightFieldError as error:  # it begins with the name of the parameter in its section
                raise LightFieldError(f"{section}.{error}") from error
            config = dataclasses.replace(config, **{section: changed})
        return config

    def _unknown(self, name: str) -> str:
        """Return the message about a parameter that the method does not have."""
        section, _, parameter = name.partition(".")
        if name == "method.name":
            return f"the preset determines the method, and this preset has {self.method}; use another preset instead."
        for old in (name, section):
            if old in self.renamed:
                now = self.renamed[old] + (f".{parameter}" if old == section else "")
                if now in dict(parameters(self)):
                    return f"parameter {name!r} is called {now!r} now; use that name."
                name = now if now in self.fixed else name
        if name in self.fixed:
            return f"{name!r} is no parameter any more, but a fixed number of {self.method}; leave it out."
        for kind in self.known.values():
            if kind is not type(self) and name in dict(parameters(kind)):
                return (
                    f"parameter {name!r} belongs to the method {kind.method}, but {self.method} does not use it; "
                    f"use a preset of {kind.method}, or leave the parameter out."
                )
        mine = dict(parameters(self))
        alike = {known: max(_alike(name, known), _alike(parameter or name, known.partition(".")[2])) for known in mine}
        nearest = max(alike, key=lambda known: alike[known])
        if alike[nearest] > _SO_ALIKE:
            return f"unknown parameter {name!r}; did you mean {nearest!r}?"
        return f"unknown parameter {name!r}; {self.method} has {', '.join(mine)}."


_SO_ALIKE = 0.8  # share of the letters of two names that are a misspelt one and the right one


def _alike(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, a, b).ratio()


def parameters(config: Config | type[Config]) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """Yield all parameters as (`section.parameter`, field); the field's metadata hold range, meaning and symbol."""
    for name, section in sections(config):
        for parameter in dataclasses.fields(section):
            yield f"{name}.{parameter.name}", parameter


def sections(config: Config | type[Config]) -> Iterator[tuple[str, Section]]:
    """Yield the sections of a configuration, or the defaults of those of a class, by name."""
    for section in dataclasses.fields(config):
        if isinstance(section.default, Section):
            yield section.name, section.default if isinstance(config, type) else getattr(config, section.name)


def value_of(config: Config, name: str) -> Any:
    """Return the value of a parameter `section.parameter`."""
    section, parameter = name.split(".")
    return getattr(getattr(config, section), parameter)


def as_dict(config: Config) -> dict[str, Any]:
    """Return the parameters as plain values: a dictionary per section, and the names of method, `Tuning` and file."""
    plain = {name: dataclasses.asdict(section) for name, section in sections(config)}
    held = {f.name: getattr(config, f.name) for f in dataclasses.fields(config)}
    named = {name: value.name if isinstance(value, Tuning) else value for name, value in held.items()}
    return {"method": config.method, **plain, **{k: str(v) for k, v in named.items() if isinstance(v, str) and v}}


def restored(values: Mapping[str, Any], presets: Mapping[str, Config]) -> Config:
    """Restore the parameters that a file holds, as `as_dict` or an older version wrote them.

    The preset with most values in common is taken. It gives what the file lacks; values that this version does not have
    are left out.
    """

    def own(config: Config) -> Iterator[tuple[str, Any]]:
        for f in dataclasses.fields(config):
            value = getattr(config, f.name)
            if isinstance(value, Section):
                yield from ((f"{f.name}.{name}", v) for name, v in dataclasses.asdict(value).items())
            elif isinstance(value, Tuning):
                yield f.name, value.name
                yield from (
                    (f"{name}.{n}", v)
                    for name, part in dataclasses.asdict(value).items()
                    if isinstance(part, dict)
                    for n, v in part.items()
                )

    stored = {
        f"{section}.{name}" if isinstance(part, Mapping) else section: value
        for section, part in values.items()
        for name, value in (part.items() if isinstance(part, Mapping) else [("", part)])
    }
    nearest = max(presets.values(), key=lambda config: sum(stored.get(name) == value for name, value in own(config)))
    there, files = dict(parameters(nearest)), [f.name for f in dataclasses.fields(nearest) if f.default == ""]
    nearest = dataclasses.replace(nearest, **{name: str(stored[name]) for name in files if name in stored})
    return nearest.with_values({name: value for name, value in stored.items() if name in there})

"""Parameters: what each says about itself, and what is said when a value is wrong."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from lfgpu.config import Config, Section, parameters
from lfgpu.errors import LightFieldError
from lfgpu.methods import PRESETS, method_of, preset
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.synthesis.config import SynthesisConfig

KINDS = (MatchingConfig, SynthesisConfig)
OWNER = {name: kind() for kind in KINDS for name, _ in parameters(kind)}
"""A configuration that has a parameter of that name."""
ALL = [(name, dict(parameters(config))[name]) for name, config in OWNER.items()]
NUMBERS = [(name, f) for name, f in ALL if "choices" not in f.metadata]
CHOICES = [(name, f) for name, f in ALL if "choices" in f.metadata]


def names(fields: list[tuple[str, Any]]) -> list[str]:
    return [name for name, _ in fields]


def value_of(config: Config, name: str) -> object:
    stage, _, parameter = name.partition(".")
    return getattr(getattr(config, stage), parameter)


def refusal(values: dict[str, Any], config: Config | None = None) -> str:
    with pytest.raises(LightFieldError) as error:
        (config or OWNER[next(iter(values))]).with_values(values)
    return str(error.value)


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_lists_each_parameter_of_each_section_once(kind: type[Config]) -> None:
    sections = {f.name: type(f.default) for f in dataclasses.fields(kind) if isinstance(f.default, Section)}
    assert len(sections) >= 4
    listed = names(list(parameters(kind())))
    assert listed == [f"{name}.{f.name}" for name, section in sections.items() for f in dataclasses.fields(section)]


def test_parameters_say_what_they_mean_and_a_range_that_holds_the_default() -> None:
    for name, field in ALL:
        assert len(field.metadata["doc"].split()) >= 3, name
        assert isinstance(field.metadata["symbol"], str), name
    for name, field in NUMBERS:
        low, high = field.metadata["low"], field.metadata["high"]
        assert low < high, name
        assert low <= field.default <= high, name
        for bound in (low, high):
            assert value_of(OWNER[name].with_values({name: bound}), name) == bound


def test_numbers_out_of_range_are_refused_with_their_range() -> None:
    for name, field in NUMBERS:
        low, high, step = field.metadata["low"], field.metadata["high"], 2 if field.metadata["odd"] else 1
        whole = isinstance(field.default, int)
        for wrong in (low - step, high + step, *(() if whole else (float("inf"), float("nan")))):
            sentence = refusal({name: wrong})
            assert sentence.startswith(f"{name} must be ")
            assert f"{low:g} to {high:g}" in sentence
            assert sentence.endswith(".")


def test_what_is_no_number_no_whole_or_no_odd_one_is_refused() -> None:
    for name, field in NUMBERS:
        for wrong in (True, None, [1.0]):
            assert refusal({name: wrong}).startswith(f"{name} must be a number")
        for fraction in (5.5, float("inf"), float("nan")) if isinstance(field.default, int) else ():
            assert re.fullmatch(rf"{name} .*\.", refusal({name: fraction}))
    for name in ("prior.window", "prior.patch"):
        assert refusal({name: 4}) == f"{name} must be odd, not 4."


def test_choices_are_named_where_there_is_no_such_one() -> None:
    for name, field in CHOICES:
        sentence = refusal({name: "best"})
        assert all(choice in sentence for choice in field.metadata["choices"])
        for choice in field.metadata["choices"]:
            assert value_of(OWNER[name].with_values({name: choice}), name) == choice


def test_configs_are_frozen_and_hold_what_is_named() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        SynthesisConfig().local.inner_scale = 2.0  # type: ignore[misc]
    with pytest.raises(LightFieldError, match="use a preset, or one of MatchingConfig, SynthesisConfig"):
        Config()
    before = SynthesisConfig()
    after = before.with_values({"local.inner_scale": 1.25, "prior.window": 7})
    assert (after.local.inner_scale, after.prior.window) == (1.25, 7)
    unchanged = [name for name, _ in parameters(before) if name not in ("local.inner_scale", "prior.window")]
    assert all(value_of(after, name) == value_of(before, name) for name in unchanged)
    assert before == SynthesisConfig()
    assert before.with_values({}) == before


# --- with_values ---


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [("local.inner_scale", "1.25", 1.25), ("prior.window", "7", 7), ("refinement.tolerance", "1e-3", 1e-3),
     ("propagation.solver", "lbfgsb", "lbfgsb"), ("refinement.solver", "lbfgsb", "lbfgsb")],
)  # fmt: skip
def test_numbers_may_be_given_as_text(name: str, text: str, value: object) -> None:
    got = value_of(OWNER[name].with_values({name: text}), name)
    assert got == value
    assert type(got) is type(value)


def test_text_that_is_no_number_or_no_whole_one_is_refused() -> None:
    for text in ("", "wide", "1,5", "7 px"):
        assert refusal({"prior.window": text}) == f"prior.window must be a number, not {text!r}."
    for text in ("7.5", "inf", "nan", "1e400"):
        assert "window" in refusal({"prior.window": text})


def test_numbers_of_numpy_become_those_that_files_hold() -> None:
    config = preset("fast").with_values({"sweep.step": np.float32(0.5), "alignment.iterations": np.int64(3)})
    assert type(value_of(config, "sweep.step")) is float
    assert type(value_of(config, "alignment.iterations")) is int


@pytest.mark.parametrize("values", [None, 5, "prior.window", [("prior.window", 11)]], ids=str)
def test_values_that_are_no_dictionary_are_refused(values: Any) -> None:
    assert refusal(values, MatchingConfig()).startswith("values must be a dictionary of parameters by name, not ")


def test_names_and_choices_of_other_types_are_refused() -> None:
    assert refusal({5: 7}, MatchingConfig()).startswith("unknown parameter '5'")  # type: ignore[dict-item]
    for value in (np.array(["full"]), np.array(["full", "star"]), ["full"], None):
        assert refusal({"sweep.views": value}).startswith("sweep.views must be one of full, ")


UNKNOWN = ["window", "prior.", "prior.windows", "priors.window", "", "prior.window.x", "local", "with_values.window"]


@pytest.mark.parametrize("config", [MatchingConfig(), SynthesisConfig()], ids=lambda config: config.method)
@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_parameters_are_refused_with_the_nearest_or_all_that_there_are(name: str, config: Config) -> None:
    sentence = refusal({name: 7}, config)
    assert repr(name) in sentence
    known = [known for known, _ in parameters(config)]
    assert all(one in sentence for one in known) or any(f"did you mean {one!r}?" in sentence for one in known)


def test_the_nearest_name_of_a_misspelt_parameter() -> None:
    for name, nearest in (("sweep.vews", "sweep.views"), ("window", "prior.window"), ("Sweep.step", "sweep.step")):
        assert refusal({name: 7}, MatchingConfig()) == f"unknown parameter {name!r}; did you mean {nearest!r}?"


@pytest.mark.parametrize(("preset_name", "name"), [("fast", "refinement.smoothness"), ("paper", "sweep.step")])
def test_a_parameter_that_the_method_does_not_read_is_refused(preset_name: str, name: str) -> None:
    config = PRESETS[preset_name]
    sentence = refusal({name: 0.5}, config)
    assert repr(name) in sentence
    assert f"{config.method} does not use it" in sentence
    assert OWNER[name].method in sentence


def test_old_names_are_answered_with_the_new_ones_or_that_there_is_none() -> None:
    for old, new in (
        ("outlines.contrast", "boundaries.contrast"),
        ("filling.max_iterations", "hole_filling.max_iterations"),
        ("matching.large_step", "semi_global.large_penalty"),
        ("sweep.most_labels", "sweep.max_labels"),
    ):
        assert new in OWNER, "the new name is one"
        assert refusal({old: 0.1}, MatchingConfig()) == f"parameter {old!r} is called {new!r} now; use that name."
    for name in ("sweep.truncation", "prior.patch", "outlines.share", "matching.window", "sweep.aperture"):
        sentence = refusal({name: 3}, MatchingConfig())
        assert sentence.endswith("is no parameter any more, but a fixed number of matching; leave it out.")


def test_users_have_about_ten_parameters_of_matching_and_old_names_lead_to_them() -> None:
    assert len(list(parameters(MatchingConfig))) <= 13
    for kind in KINDS:
        known = {part for name, _ in parameters(kind) for part in (name, name.partition(".")[0])}
        assert set(kind.renamed.values()) <= known


@pytest.mark.parametrize("name", ["propagation.solver", "refinement.solver"])
def test_a_solver_of_scipy_takes_the_method_off_the_device(name: str) -> None:
    assert method_of(SynthesisConfig()).is_on_device
    assert not method_of(SynthesisConfig().with_values({name: "lbfgsb"})).is_on_device


# --- presets ---


def test_presets_are_those_that_there_are() -> None:
    assert "paper" in PRESETS
    for name, config in PRESETS.items():
        assert preset(name) is config
        assert isinstance(config, Config)
    with pytest.raises(LightFieldError) as error:
        preset("best")
    assert "'best'" in str(error.value)
    assert all(name in str(error.value) for name in PRESETS)

"""Parameters: what each says about itself, and what is said when a value is wrong."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from lfgpu.config import (
    PRESETS,
    AlignmentConfig,
    Config,
    FillingConfig,
    LocalConfig,
    MatchingConfig,
    MethodConfig,
    OutlinesConfig,
    PriorConfig,
    PropagationConfig,
    RefinementConfig,
    SweepConfig,
    parameters,
    preset,
)
from lfgpu.errors import LightFieldError

STAGES = (
    MethodConfig,
    LocalConfig,
    PriorConfig,
    PropagationConfig,
    RefinementConfig,
    SweepConfig,
    MatchingConfig,
    AlignmentConfig,
    OutlinesConfig,
    FillingConfig,
)
ALL = list(parameters(Config()))
NUMBERS = [(name, f) for name, f in ALL if "choices" not in f.metadata]
CHOICES = [(name, f) for name, f in ALL if "choices" in f.metadata]


def names(fields: list[tuple[str, Any]]) -> list[str]:
    return [name for name, _ in fields]


def value_of(config: Config, name: str) -> object:
    stage, _, parameter = name.partition(".")
    return getattr(getattr(config, stage), parameter)


def refusal(values: dict[str, Any]) -> str:
    with pytest.raises(LightFieldError) as error:
        Config().with_values(values)
    return str(error.value)


def test_parameters_lists_each_parameter_of_each_stage_once() -> None:
    stages = {f.name: type(getattr(Config(), f.name)) for f in dataclasses.fields(Config)}
    assert set(stages.values()) == set(STAGES)
    assert names(ALL) == [f"{stage}.{f.name}" for stage, kind in stages.items() for f in dataclasses.fields(kind)]


@pytest.mark.parametrize(("name", "field"), ALL, ids=names(ALL))
def test_every_parameter_says_what_it_means(name: str, field: Any) -> None:
    assert len(field.metadata["doc"].split()) >= 3
    assert isinstance(field.metadata["symbol"], str)


@pytest.mark.parametrize(("name", "field"), NUMBERS, ids=names(NUMBERS))
def test_every_number_has_a_range_that_holds_its_default(name: str, field: Any) -> None:
    low, high = field.metadata["low"], field.metadata["high"]
    assert low < high
    assert low <= field.default <= high
    for bound in (low, high):
        assert value_of(Config().with_values({name: bound}), name) == bound


@pytest.mark.parametrize(("name", "field"), NUMBERS, ids=names(NUMBERS))
def test_numbers_out_of_range_are_refused_with_their_range(name: str, field: Any) -> None:
    low, high, step = field.metadata["low"], field.metadata["high"], 2 if field.metadata["odd"] else 1
    for wrong in (low - step, high + step, float("inf"), float("nan")):
        if isinstance(field.default, int) and wrong - wrong != 0:
            continue  # below: not whole
        sentence = refusal({name: wrong})
        assert field.name in sentence
        assert f"{low:g} to {high:g}" in sentence
        assert sentence.endswith(".")


@pytest.mark.parametrize(("name", "field"), NUMBERS, ids=names(NUMBERS))
@pytest.mark.parametrize("wrong", [True, None, [1.0]], ids=repr)
def test_what_is_no_number_is_refused(name: str, field: Any, wrong: object) -> None:
    assert refusal({name: wrong}).startswith(f"{field.name} must be a number")


WHOLE = [(name, f) for name, f in NUMBERS if isinstance(f.default, int)]


@pytest.mark.parametrize(("name", "field"), WHOLE, ids=names(WHOLE))
@pytest.mark.parametrize("wrong", [5.5, float("inf"), float("nan")], ids=repr)
def test_whole_numbers_are_whole(name: str, field: Any, wrong: float) -> None:
    sentence = refusal({name: wrong})
    assert field.name in sentence
    assert sentence.endswith(".")


@pytest.mark.parametrize("name", ["prior.window", "prior.patch", "matching.window"])
def test_sides_of_windows_are_odd(name: str) -> None:
    assert refusal({name: 4}) == f"{name.partition('.')[2]} must be odd, not 4."


@pytest.mark.parametrize(("name", "field"), CHOICES, ids=names(CHOICES))
def test_choices_are_named_where_there_is_no_such_one(name: str, field: Any) -> None:
    sentence = refusal({name: "best"})
    assert all(choice in sentence for choice in field.metadata["choices"])
    for choice in field.metadata["choices"]:
        assert value_of(Config().with_values({name: choice}), name) == choice


def test_configs_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().local.inner_scale = 2.0  # type: ignore[misc]


# --- with_values ---


def test_with_values_changes_what_is_named_and_nothing_else() -> None:
    before = Config()
    after = before.with_values({"local.inner_scale": 1.25, "prior.window": 7})
    assert (after.local.inner_scale, after.prior.window) == (1.25, 7)
    unchanged = [name for name in names(ALL) if name not in ("local.inner_scale", "prior.window")]
    assert all(value_of(after, name) == value_of(before, name) for name in unchanged)
    assert before == Config()
    assert before.with_values({}) == before


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [("local.inner_scale", "1.25", 1.25), ("prior.window", "7", 7), ("refinement.tolerance", "1e-3", 1e-3),
     ("propagation.solver", "lbfgsb", "lbfgsb"), ("refinement.solver", "lbfgsb", "lbfgsb")],
)  # fmt: skip
def test_numbers_may_be_given_as_text(name: str, text: str, value: object) -> None:
    got = value_of(Config().with_values({name: text}), name)
    assert got == value
    assert type(got) is type(value)


@pytest.mark.parametrize("text", ["", "wide", "1,5", "7 px"])
def test_text_that_is_no_number_is_refused(text: str) -> None:
    assert refusal({"prior.window": text}) == f"prior.window must be a number, not {text!r}."


@pytest.mark.parametrize("text", ["7.5", "inf", "nan", "1e400"])
def test_text_that_is_no_whole_number_is_refused(text: str) -> None:
    sentence = refusal({"prior.window": text})
    assert "window" in sentence


UNKNOWN = ["window", "prior.", "prior.windows", "priors.window", "", "prior.window.x", "local", "with_values.window"]


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_parameters_are_refused_with_all_that_there_are(name: str) -> None:
    sentence = refusal({name: 7})
    assert repr(name) in sentence
    assert all(known in sentence for known in names(ALL))


@pytest.mark.parametrize("name", ["propagation.solver", "refinement.solver"])
def test_a_solver_of_scipy_takes_the_method_off_the_device(name: str) -> None:
    assert Config().is_on_device
    assert not Config().with_values({name: "lbfgsb"}).is_on_device


# --- presets ---


def test_there_is_the_preset_of_the_paper() -> None:
    assert "paper" in PRESETS
    for name, config in PRESETS.items():
        assert preset(name) is config
        assert isinstance(config, Config)


def test_an_unknown_preset_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(LightFieldError) as error:
        preset("best")
    assert "'best'" in str(error.value)
    assert all(name in str(error.value) for name in PRESETS)

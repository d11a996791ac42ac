"""The seam between host and kernels: which backends there are, and what is said when one is not there."""

from __future__ import annotations

import builtins
import importlib
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from lfgpu import _backends
from lfgpu.errors import BackendError
from lfgpu.types import KernelSet


def machine_with(*devices: str) -> KernelSet:
    return cast(KernelSet, SimpleNamespace(name="some", devices=lambda: devices))


def test_warp_is_the_default_and_the_reference_is_there() -> None:
    backends = _backends.list_backends()
    assert backends[0] == _backends.DEFAULT == "warp"
    assert "reference" in backends


def test_backends_have_the_name_under_which_they_are_asked_for(target: Any) -> None:
    assert _backends.load(target.backend).name == target.backend


def test_the_reference_computes_in_double_and_others_in_single(target: Any) -> None:
    assert target.kernels.dtype is (np.float64 if target.backend == "reference" else np.float32)


def test_an_unknown_backend_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(BackendError) as error:
        _backends.load("fpga")
    assert str(error.value) == f"unknown backend 'fpga'; there are {', '.join(_backends.list_backends())}."


@pytest.mark.parametrize(("backend", "package"), list(_backends._PACKAGES.items()))
def test_a_missing_package_is_named_with_how_to_install_it(
    backend: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {package!r}")

    monkeypatch.setattr(_backends.importlib, "import_module", missing)
    with pytest.raises(BackendError) as error:
        _backends.load(backend)
    for words in (repr(backend), f"No module named {package!r}", f"pip install {package}"):
        assert words in str(error.value)
    assert isinstance(error.value.__cause__, ModuleNotFoundError)


def test_every_backend_is_a_package_of_that_name(monkeypatch: pytest.MonkeyPatch) -> None:
    for backend in _backends.list_backends():
        assert importlib.util.find_spec(f"lfgpu.kernels.{backend}") is not None


def test_loading_the_reference_does_not_load_warp(monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def watched(name: str, *args: Any, **kwargs: Any) -> Any:
        assert name.partition(".")[0] not in ("warp", "taichi")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", watched)
    assert _backends.load("reference").devices() == ("cpu",)


# --- devices ---


@pytest.mark.parametrize(
    ("asked", "found"), [(None, "cuda:0"), ("cuda", "cuda:0"), ("cuda:1", "cuda:1"), ("cpu", "cpu")]
)
def test_devices_are_picked_by_name(asked: str | None, found: str) -> None:
    assert _backends.pick_device(machine_with("cuda:0", "cuda:1", "cpu"), asked) == found


@pytest.mark.parametrize("asked", ["cuda", "cuda:0", "cuda:7", "tpu", ""])
def test_a_device_that_is_not_there_is_refused_with_those_that_are(asked: str) -> None:
    with pytest.raises(BackendError) as error:
        _backends.pick_device(machine_with("cpu"), asked)
    assert str(error.value) == f"backend 'some' sees no device {asked!r} here; there is cpu."

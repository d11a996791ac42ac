"""The seam between host and kernels: backends, sentences for what is missing, and compiling that is timed by itself."""

import importlib
import importlib.metadata
import importlib.util
import threading
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import warp as wp
from lfgpu.kernels.warp import threads

from lfgpu import _backends, scenes
from lfgpu._backends import load, open_device
from lfgpu.contract import KernelSet
from lfgpu.data import LightField
from lfgpu.errors import BackendError
from lfgpu.methods import method_of
from lfgpu.methods.base import Work
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.pipelines import pipeline, rehearsal
from lfgpu.pipelines.estimate import estimate_depth
from tests.made import raising


def machine_with(*devices: str) -> KernelSet:
    return cast(KernelSet, SimpleNamespace(name="some", devices=lambda: devices))


def test_backends_are_found_by_their_names(target: Any) -> None:
    backends = _backends.list_backends()
    assert backends[0] == _backends.DEFAULT == "warp"
    assert "reference" in backends
    assert _backends.load(target.backend).name == target.backend
    assert target.kernels.dtype is (np.float64 if target.backend == "reference" else np.float32)
    with pytest.raises(BackendError) as error:
        _backends.load("fpga")
    assert str(error.value) == f"unknown backend 'fpga'; use one of {', '.join(_backends.list_backends())}."
    with pytest.raises(BackendError, match="unknown backend \\['warp'\\]"):
        _backends.load(["warp"])  # type: ignore[arg-type]
    for backend in _backends.list_backends():
        assert importlib.util.find_spec(f"lfgpu.kernels.{backend}") is not None


@pytest.mark.parametrize(("backend", "package"), list(_backends._PACKAGES.items()))
def test_a_missing_package_is_named_with_how_to_install_it(
    backend: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {package!r}")

    monkeypatch.setattr(_backends.importlib, "import_module", missing)
    monkeypatch.setattr(_backends, "version_of", lambda package: None)
    with pytest.raises(BackendError) as error:
        _backends.load(backend)
    assert str(error.value) == (
        f"backend {backend!r} cannot be loaded (No module named {package!r}); install it with: pip install {package}"
    )
    assert isinstance(error.value.__cause__, ModuleNotFoundError)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError("libsome.so: cannot open\nshared object file"), "OSError: libsome.so: cannot open shared object file"),
        (AttributeError("module 'numpy' has no attribute 'int'"), "AttributeError: module 'numpy' has no attribute"),
        (RuntimeError(), "RuntimeError"),
        (ImportError("DLL load failed"), "(DLL load failed)"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_broken_installation_is_a_sentence_too(error: Exception, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_backends.importlib, "import_module", raising(error))
    with pytest.raises(BackendError) as refused:
        _backends.load("reference")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert str(refused.value).endswith("pip install --force-reinstall numpy")


# --- what is here ---


def test_all_backends_are_described_the_default_first(target: Any) -> None:
    described = {info.name: info for info in _backends.describe_backends()}
    assert tuple(described) == _backends.list_backends()
    info = described[target.backend]
    assert info.package == _backends.package_of(target.backend)
    assert info.version == importlib.metadata.version(info.package)
    assert info.devices == target.kernels.devices()
    assert info.problem is None
    assert info.remedy is None


def test_one_backend_that_fails_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    right = importlib.import_module

    def broken(name: str) -> Any:
        return raising(OSError("a broken library"))() if name == "lfgpu.kernels.warp" else right(name)

    monkeypatch.setattr(_backends.importlib, "import_module", broken)
    described = {info.name: info for info in _backends.describe_backends()}
    assert described["reference"].devices == ("cpu",)
    warp = described["warp"]
    assert warp.devices == ()
    assert warp.problem == "cannot be loaded: OSError: a broken library"
    assert warp.remedy == "pip install --force-reinstall warp-lang"


def test_parts_that_are_missing_are_problems_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(_backends._PACKAGES, "fpga", "no-such-package")
    info = _backends.describe_backends()[-1]
    assert (info.name, info.version, info.devices) == ("fpga", None, ())
    assert info.problem == "cannot be loaded: No module named 'lfgpu.kernels.fpga'"
    assert info.remedy == "pip install no-such-package"
    failing = SimpleNamespace(KERNELS=SimpleNamespace(devices=raising(RuntimeError("the driver is too old"))))
    monkeypatch.setattr(_backends.importlib, "import_module", lambda name: failing)
    info = _backends.describe_backends()[0]
    assert info.problem == "cannot list its devices: RuntimeError: the driver is too old"
    assert info.version is not None
    assert info.remedy is None


# --- devices ---


def test_devices_are_picked_by_name() -> None:
    for asked, found in ((None, "cuda:0"), ("cuda", "cuda:0"), ("cuda:1", "cuda:1"), ("cpu", "cpu")):
        assert _backends.pick_device(machine_with("cuda:0", "cuda:1", "cpu"), asked) == found


def test_a_device_that_is_not_there_is_refused_with_those_that_are() -> None:
    names = "; GPUs are named cuda (the first), cuda:1 and so on, vulkan or metal"
    for asked in ("cuda", "cuda:0", "cuda:7", "gpu", "tpu", "", 0):
        said = "" if str(asked).startswith("cuda") else names
        with pytest.raises(BackendError) as error:
            _backends.pick_device(machine_with("cpu"), asked)
        assert str(error.value) == f"backend 'some' finds no device {asked!r}; use one of cpu{said}."


COMPILING, WORKING = 100.0, 1.0
RANGE = (-2.0, 2.0)


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The stages that were compiled, as if nothing were yet: on a clock that only compiling and working move on."""
    seconds, done, stages = [0.0], set[str](), MatchingPlan.stages
    monkeypatch.setattr(rehearsal, "_known", set())
    monkeypatch.setattr(pipeline, "perf_counter", lambda: seconds[0])

    def timed(name: str, work: Work) -> Work:
        def run(callback: Callable[[int, float], None] | None) -> None:
            seconds[0] += WORKING + (0.0 if name in done else COMPILING)
            done.add(name)
            work(callback)

        return run

    def slow(self: MatchingPlan, views: Any) -> dict[str, Work]:
        return {name: timed(name, work) for name, work in stages(self, views).items()}

    monkeypatch.setattr(MatchingPlan, "stages", slow)
    return done


def a_light_field() -> LightField:
    return scenes.make("relief", grid=(3, 3), size=(40, 48))


def test_the_first_stage_is_not_charged_with_compiling(compiled: set[str]) -> None:
    lf = a_light_field()
    first = estimate_depth(lf, config="fast", disparity_range=RANGE).timings
    stages = [stage.name for stage in method_of("fast").stages]
    assert compiled == set(stages)
    assert list(first) == ["compile", "measure", *stages, "total"]
    assert {first[stage] for stage in stages} == {WORKING}
    assert first["compile"] == len(stages) * (COMPILING + WORKING)
    assert first["total"] == first["compile"] + first["measure"] + len(stages) * WORKING
    again = estimate_depth(lf, config="fast", disparity_range=RANGE).timings
    assert again["compile"] == 0
    assert again["total"] == len(stages) * WORKING


def test_nothing_is_rehearsed_where_nothing_is_compiled(compiled: set[str]) -> None:
    assert not load("reference").compiles
    timings = estimate_depth(a_light_field(), config="fast", disparity_range=RANGE, backend="reference").timings
    assert timings["compile"] == 0


def test_a_rehearsal_loads_all_kernels_at_once_and_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    loads: list[str] = []
    load_module = threads._load

    def watched(*variant: Any) -> None:
        loads.append(threading.current_thread().name)
        load_module(*variant)

    monkeypatch.setattr(threads, "_loaded", set())
    monkeypatch.setattr(rehearsal, "_known", set())
    lf, place = a_light_field(), open_device(device="cpu")
    made = pipeline.DepthPipeline(lf, config="fast", disparity_range=RANGE, device="cpu")
    loaded = set(threads._loaded)
    made.estimate()
    assert threads._loaded == loaded
    monkeypatch.setattr(threads, "_loaded", set())
    monkeypatch.setattr(threads, "_load", watched)
    rehearsal._known.clear()
    rehearsal.Rehearsal(made.method, lf, place).run(made.measured)
    assert len(loads) == len(threads._loaded) > 20
    assert all(name.startswith("lfgpu-compiling") for name in loads)
    assert len({wp.get_module_options(module)["cpu_compiler_flags"] for module, *_ in threads._loaded}) == 1
    loads.clear()
    monkeypatch.setattr(threads, "_loaded", set())
    made.estimate()  # what was not rehearsed is compiled by the same threads
    assert loads
    assert all(name.startswith("lfgpu-compiling") for name in loads)


def test_measuring_loads_no_kernel_that_was_not_rehearsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_loaded", set())
    monkeypatch.setattr(rehearsal, "_known", set())
    lf, place, method = scenes.make("relief", grid=(3, 3), size=(96, 128)), open_device(device="cpu"), method_of("fast")
    rehearsal.Rehearsal(method, lf, place).measure(None)
    loaded = set(threads._loaded)
    method.measure(lf, place)
    assert threads._loaded == loaded


def test_prepared_work_is_still_to_be_done(target: Any) -> None:
    kernels, device = target.kernels, target.device
    field, calls = kernels.zeros((4, 5), device), []
    go_on = kernels.scalar(1.0, device)

    def work() -> None:
        calls.append(1)
        kernels.fill(3.0, field)
        kernels.repeat(lambda: kernels.axpby(1.0, go_on, -1.0, go_on, go_on), go_on, 2)

    kernels.prepare(work, device)
    assert calls == [1]
    kernels.upload(np.zeros((4, 5), np.float32), field)
    kernels.fill(3.0, field)
    np.testing.assert_array_equal(kernels.numpy(field), 3.0)


def test_views_without_anything_in_their_middle_can_be_estimated(compiled: set[str]) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(96, 96))
    views = lf.views.copy()
    views[:, 30:66, 30:66] = 0
    valid = np.ones(views.shape[:3], np.bool_)
    valid[:, 30:66, 30:66] = False
    result = estimate_depth(replace(lf, views=views, valid=valid, truth=None), config="fast")
    assert result.timings["compile"] > 0

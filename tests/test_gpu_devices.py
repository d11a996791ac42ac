"""Devices of Vulkan and Metal: which is chosen, how they are named, and what is said where one is missing."""

import os
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from lfgpu import _backends, machine, vulkan
from lfgpu._backends import BackendInfo
from lfgpu.cli import checkup
from lfgpu.errors import BackendError
from lfgpu.scenes import make

GPU = vulkan.VulkanDevice(0, "Arc A770", "Mesa 24", 2, 16 * 2**30, 2**30, (), True)
INTEGRATED = replace(GPU, number=1, name="Iris Xe", type=1, has_doubles=False)
SOFTWARE = replace(GPU, number=2, name="llvmpipe", type=4)

runtime = pytest.importorskip("lfgpu.kernels.taichi.runtime")


@pytest.fixture(autouse=True)
def _nothing_is_known() -> Iterator[None]:
    caches = vulkan.choose, runtime.devices, runtime.double, runtime.most_bytes
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


def end(*_: Any) -> None:
    """End the process, as a broken driver does."""
    os._exit(1)


def there(monkeypatch: pytest.MonkeyPatch, *devices: vulkan.VulkanDevice, arches: tuple[str, ...] = ()) -> None:
    """Make these the devices of Vulkan, and these the kinds of devices that Taichi can use."""
    monkeypatch.setattr(vulkan, "_devices", lambda: iter(devices))
    arches = tuple(runtime._ARCHES[device] for device in arches)
    monkeypatch.setattr(runtime.ti.lang.misc, "is_arch_supported", lambda arch: arch in arches)


def refused(monkeypatch: pytest.MonkeyPatch, *devices: vulkan.VulkanDevice) -> str:
    there(monkeypatch, *devices)
    with pytest.raises(BackendError) as error:
        vulkan.choose()
    assert machine.device_name("vulkan") is None
    assert machine.device_memory("vulkan") is None
    return str(error.value)


def test_a_child_of_a_process_with_taichi_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hook of a forked child runs here without a child."""
    monkeypatch.setattr(runtime, "_forked", False)
    monkeypatch.setattr(runtime.impl, "get_runtime", lambda: SimpleNamespace(prog=None))
    runtime._in_child()
    runtime.alone()
    monkeypatch.setattr(runtime.impl, "get_runtime", lambda: SimpleNamespace(prog="started"))
    runtime._in_child()
    with pytest.raises(BackendError, match='processes by "spawn"'):
        runtime.alone()


def test_a_gpu_with_memory_of_its_own_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    there(monkeypatch, SOFTWARE, INTEGRATED, GPU)
    assert vulkan.choose() == GPU
    assert machine.device_name("vulkan") == "Arc A770 (Mesa 24)"
    assert machine.device_memory("vulkan") == 16 * 2**30


def test_the_user_may_choose_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TI_VISIBLE_DEVICE", "1")
    there(monkeypatch, GPU, INTEGRATED)
    assert vulkan.choose() == INTEGRATED
    vulkan.choose.cache_clear()
    assert refused(monkeypatch, GPU) == "TI_VISIBLE_DEVICE must be a number from 0 to 0; found '1'."


def test_a_missing_loader_and_a_missing_driver_say_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "finds no driver of a GPU; install it with the driver of your GPU" in refused(monkeypatch)
    monkeypatch.undo()
    monkeypatch.setattr(vulkan, "_LIBRARY", "libnothing.so.1")
    with pytest.raises(BackendError) as error:
        vulkan.choose()
    assert str(error.value).startswith("Vulkan's loader (libnothing.so.1) is not installed; install it")
    assert "apt-get install libvulkan1 mesa-vulkan-drivers" in str(error.value)


def test_a_driver_that_lacks_something_is_named_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    old = replace(GPU, lacks=("8-bit storage", "16-bit storage"))
    assert refused(monkeypatch, old) == (
        "the Vulkan driver of Arc A770 (Mesa 24) lacks 8-bit storage and 16-bit storage; install a newer driver, or "
        "use the device 'cpu'."
    )


def test_a_driver_is_asked_for_all_that_is_said_of_it() -> None:
    """In Vulkan's structures: on Mesa's driver these are its facts."""
    try:
        found = next(device for device in vulkan._devices() if device.driver.startswith("llvmpipe Mesa"))
    except (BackendError, StopIteration):
        pytest.skip("Mesa's Vulkan driver for the CPU is not installed")
    assert found.name.startswith("llvmpipe (LLVM ")
    assert (found.is_software, found.lacks, found.has_doubles) == (True, (), True)
    assert found.largest >= 2**27
    assert found.memory >= 2**30
    assert vulkan._LEAST == 1 << 22 | 2 << 12


# --- Taichi ---


@pytest.mark.parametrize(
    ("arches", "devices", "found"),
    [
        (("cpu",), (GPU,), ("cpu",)),
        (("cuda:0", "vulkan", "cpu"), (GPU,), ("cuda:0", "vulkan", "cpu")),
        (("vulkan", "cpu"), (INTEGRATED, SOFTWARE), ("vulkan", "cpu")),
        (("vulkan", "cpu"), (SOFTWARE,), ("cpu", "vulkan")),
        (("vulkan", "cpu"), (replace(GPU, lacks=("8-bit storage",)),), ("cpu",)),
        (("metal", "cpu"), (), ("metal", "cpu")),
        (("vulkan", "metal", "cpu"), (), ("metal", "cpu")),  # Vulkan on top of Metal has no loader of its own
    ],
    ids=str,
)
def test_the_first_device_is_the_fastest(
    arches: tuple[str, ...],
    devices: tuple[vulkan.VulkanDevice, ...],
    found: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there(monkeypatch, *devices, arches=arches)
    assert runtime.devices() == found


@pytest.mark.parametrize(
    ("running", "bits"), [("cpu", 64), ("cuda:0", 64), ("vulkan", 64), ("integrated", 32), ("metal", 32)]
)
def test_numbers_have_64_bits_where_the_gpu_has_them(running: str, bits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    there(monkeypatch, INTEGRATED if running == "integrated" else GPU)
    monkeypatch.setattr(runtime, "_running", lambda: "vulkan" if running == "integrated" else running)
    assert runtime.double() is {32: runtime.ti.f32, 64: runtime.ti.f64}[bits]


def test_arrays_that_a_device_cannot_hold_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from lfgpu.kernels.taichi import memory

    memory.zeros((1,), runtime._running() if runtime.impl.get_runtime().prog else "cpu")
    monkeypatch.setattr(memory, "most_bytes", lambda: 2**20)
    with pytest.raises(BackendError, match=r"of 524288 values \(2 MiB\), at most 1 MiB here: use max_memory, fewer"):
        memory.empty((512, 1024))
    with pytest.raises(BackendError, match=r"of 2097152 values \(2 MiB\)"):
        memory.empty((2048, 1024), scalar=runtime.ti.u8)

    def full(*_: Any) -> None:
        raise RuntimeError("res == RhiResult::success")

    monkeypatch.setattr(memory, "_Scalars", full)
    with pytest.raises(BackendError, match=r"has too little memory left for an array of 1 MiB: use max_memory, or"):
        memory.empty((512, 512))


# --- what users are told ---


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("metal", "; Metal needs macOS on Apple silicon and the backend 'taichi'."),
        ("vulkan", "; the backend 'taichi' runs on Arc A770."),
    ],
)
def test_a_device_that_another_backend_has(device: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    there(monkeypatch, GPU)
    kernels: Any = SimpleNamespace(name="some", devices=lambda: ("cpu",))
    with pytest.raises(BackendError) as error:
        _backends.pick_device(kernels, device)
    assert str(error.value) == f"backend 'some' finds no device {device!r}; use one of cpu{said}"


def test_a_device_that_is_missing_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    there(monkeypatch)
    kernels: Any = SimpleNamespace(name="taichi", devices=lambda: ("cpu",))
    with pytest.raises(BackendError, match=r"'vulkan'; use one of cpu; Vulkan's loader finds no driver .* maker\.$"):
        _backends.pick_device(kernels, "vulkan")


def test_work_is_spread_over_devices_of_one_kind() -> None:
    kernels: Any = SimpleNamespace(devices=lambda: ("cuda:0", "cuda:1", "vulkan", "cpu"))
    assert _backends.alike(kernels, "cuda:1") == ("cuda:0", "cuda:1")
    assert _backends.alike(kernels, "vulkan") == ("vulkan",)
    assert _backends.alike(kernels, "cpu") == ("cpu",)


def test_doctor_tries_further_devices_of_taichi_in_processes_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    info = BackendInfo("taichi", "taichi", "1.7", ("vulkan", "cpu"))
    asked = []

    def estimate(name: str) -> Any:
        def run(lf: Any, backend: str, device: str, expected: Any) -> Any:
            asked.append((name, device))
            return checkup.Trial(device, 0.0), None

        return run

    monkeypatch.setattr(checkup, "_estimate", estimate("here"))
    monkeypatch.setattr(checkup, "_estimate_apart", estimate("apart"))
    list(checkup._trials((info,), ()))
    assert asked == [("here", "vulkan"), ("apart", "cpu")]


def test_a_process_of_its_own_finds_the_same_and_may_end(monkeypatch: pytest.MonkeyPatch) -> None:
    lf = make("relief", grid=(3, 3), size=(32, 40), disparity_range=(-1.5, 1.5))
    trial, found = checkup._estimate_apart(lf, "reference", "cpu", None)
    assert (trial.what, trial.problem) == ("reference on cpu", None)
    assert found is not None
    monkeypatch.setattr(checkup, "_estimate", end)
    trial, found = checkup._estimate_apart(lf, "reference", "cpu", None)
    assert trial.problem == "The estimate by reference on cpu ended its process."
    assert found is None

"""Arrays of other libraries go in and come out, without the host where it can be avoided, in the order of streams."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.data import LightField, interop
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.pipelines.pipeline import DepthPipeline
from tests.made import Tensor

RANGE = (-1.5, 1.5)
CONFIG = SynthesisConfig().with_values({"prior.window": 5, "refinement.max_iterations": 8})
SAME = 1e-3  # pixels per view step, median: sums are in an order that a GPU decides
SHAPE = (3, 5, 6, 3)
STORED = ("uint8", "uint16", "float32")


@cache
def scene(seed: int = 0, dtype: str = "uint8") -> LightField:
    return scenes.make("relief", grid=(3, 5), size=(32, 36), seed=seed, dtype=dtype)


def made(lf: LightField, target: Any) -> DepthPipeline:
    return DepthPipeline(lf, config=CONFIG, disparity_range=RANGE, backend=target.backend, device=target.device)


def values_of(dtype: str, rng: np.random.Generator) -> np.ndarray:
    values = rng.random(SHAPE)
    return (values if dtype == "float32" else values * np.iinfo(dtype).max).astype(dtype)


class Elsewhere(Tensor):
    """One that says it is on another device."""

    def __init__(self, values: np.ndarray, device: tuple[int, int]) -> None:
        super().__init__(values)
        self._device = device

    def __dlpack__(self, **options: Any) -> Any:
        raise BufferError("no way out")

    def __dlpack_device__(self) -> Any:
        return self._device


class Interface:
    """An array with nothing but NumPy's array interface, a dtype and a shape."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values
        self.shape, self.dtype, self.__array_interface__ = values.shape, values.dtype, values.__array_interface__


# --- views that go in ---


def assert_same(found: np.ndarray, wanted: np.ndarray, device: str) -> None:
    """To the bit on a CPU."""
    apart = np.abs(found - wanted)
    assert (apart.max() == 0) if device == "cpu" else (np.median(apart) <= SAME)


def of_torch(values: np.ndarray) -> Any:
    return pytest.importorskip("torch", reason="PyTorch is not installed").from_numpy(values)


@pytest.mark.parametrize("kind", [Tensor, Interface, of_torch])
def test_arrays_of_other_libraries_go_in(target: Any, kind: Any) -> None:
    """Whatever their strides."""
    pipeline, want = made(scene(), target), made(scene(1), target)
    pipeline.upload(kind(np.asfortranarray(scene(1).views)))
    for one in (pipeline, want):
        one.run()
    assert_same(pipeline.disparity(), want.disparity(), target.device)


def test_a_light_field_is_made_of_any_array() -> None:
    lf = scene()
    for kind in (Tensor, Interface):
        np.testing.assert_array_equal(LightField(kind(lf.views), lf.positions).views, lf.views)  # type: ignore[arg-type]
    grid = lf.views.reshape(3, 5, *lf.views.shape[1:])
    np.testing.assert_array_equal(LightField.from_grid(Tensor(grid)).views, lf.views)  # type: ignore[arg-type]


def test_views_that_are_not_finite_are_refused() -> None:
    lf = scene(dtype="float32")
    pipeline = DepthPipeline(lf, config=CONFIG, disparity_range=RANGE, device="cpu")
    views = lf.views.copy()
    views[4, 3, 2] = np.nan
    for kind in (np.asarray, Tensor):
        with pytest.raises(LightFieldError, match=r"^views hold NaN or infinity; .*\.$"):
            pipeline.upload(kind(views))


# --- views that do not ---


class Opaque:
    """An array that says neither type nor shape."""

    def __dlpack_device__(self) -> Any:
        return (1, 0)


WRONG = [
    (lambda views: [1, 2, 3], "views must be an array, not list."),
    (lambda views: None, "views must be an array, not NoneType."),
    (lambda views: Opaque(), "views must be an array with a dtype and a shape, not Opaque."),
    (
        lambda views: Tensor(views[1:]),
        "views must be uint8 [15, 32, 36, 3], like those that the pipeline was made for; found uint8 [14, 32, 36, 3].",
    ),
    (
        lambda views: Tensor(views.astype(np.float64)),
        "views must be uint8 [15, 32, 36, 3], like those that the pipeline was made for; found float64 [15, 32, 36, "
        "3].",
    ),
    (
        lambda views: Elsewhere(views, (2, 1)),
        "views are on cuda:1, but the pipeline is on cpu with backend 'warp'; copy them to the CPU first, or make the "
        "pipeline for that GPU with backend 'warp'.",
    ),
    (
        lambda views: Elsewhere(views, (10, 0)),
        "views are neither on a CPU nor on a CUDA GPU (DLPack device type 10); copy them to the CPU first.",
    ),
    (
        lambda views: np.ma.masked_less(views, 100),
        "views are masked here and there, but only a LightField takes masks; fill them first.",
    ),
    (lambda views: Elsewhere(views, (1, 0)), "views cannot be read (no way out); convert them to NumPy first."),
]


def test_what_cannot_go_in_is_said_in_one_sentence_and_changes_nothing() -> None:
    pipeline = DepthPipeline(scene(), config=CONFIG, disparity_range=RANGE, device="cpu")
    pipeline.run()
    want = pipeline.disparity()
    for wrong, sentence in WRONG:
        with pytest.raises(LightFieldError) as error:
            pipeline.upload(wrong(scene(1).views))
        assert str(error.value) == sentence
    pipeline.run()
    np.testing.assert_array_equal(pipeline.disparity(), want)


def test_a_light_field_of_what_does_not_come_to_the_cpu_is_refused() -> None:
    with pytest.raises(LightFieldError) as error:
        LightField(Elsewhere(scene().views, (2, 0)), scene().positions)  # type: ignore[arg-type]
    assert str(error.value) == "views on cuda:0 cannot be read (no way out); convert them to NumPy first."


def test_places_have_names() -> None:
    views = scene().views
    assert interop.place_of("views", views) == interop.place_of("views", Tensor(views)) == "cpu"
    assert interop.place_of("views", Elsewhere(views, (3, 0))) == "cpu"  # pinned
    assert interop.place_of("views", Elsewhere(views, (13, 2))) == "cuda:2"  # managed


# --- maps that come out ---


def shares(target: Any) -> None:
    if target.backend == "taichi":
        pytest.skip("Taichi has no arrays that other libraries could take")


def test_maps_on_a_cpu_are_shared(target: Any) -> None:
    if target.device != "cpu":
        pytest.skip("this is about the CPU")
    shares(target)
    pipeline = made(scene(), target)
    disparity, confidence = np.from_dlpack(pipeline.device_disparity), np.asarray(pipeline.device_confidence)
    for seed in range(2):  # the second is there without taking it again
        pipeline.upload(scene(seed).views)
        pipeline.run()
        np.testing.assert_array_equal(disparity.astype(np.float32), pipeline.disparity())
        np.testing.assert_array_equal(confidence.astype(np.float32), pipeline.result().confidence)


def test_maps_stay_where_they_are(target: Any) -> None:
    pipeline = DepthPipeline(scene(), config=CONFIG, disparity_range=RANGE, device="cpu")
    pipeline.run()
    want, there = pipeline.disparity(), pipeline.device_disparity
    copies = [np.from_dlpack(there, copy=True), np.array(there), np.from_dlpack(there, device="cpu", copy=True)]
    pipeline.upload(scene(1).views)
    pipeline.run()
    for copy in copies:
        np.testing.assert_array_equal(copy, want)
    assert (there.shape, there.dtype) == (want.shape, want.dtype)
    with pytest.raises(BufferError, match=r"the map is on cpu and does not leave it by DLPack\."):
        pipeline.device_disparity.__dlpack__(dl_device=(2, 0))
    if target.backend != "taichi":
        pytest.skip("this is about Taichi")
    with pytest.raises(BackendError, match=r"copy the map with disparity\(\), or use backend 'warp'\.$"):
        _ = made(scene(), target).device_disparity


# --- on a GPU ---
#
# Work on a stream is held up by kernels that do nothing for DELAY cycles, a few hundredths of a second: what does not
# wait for it sees what was there before. Each order that is kept is shown to be broken where nobody keeps it.

DELAY = 100_000_000


@pytest.fixture
def gpu() -> Any:
    """Warp's first GPU."""
    if "cuda:0" not in load("warp").devices():
        pytest.skip("Warp sees no GPU")
    import warp

    return warp.get_device("cuda:0")


@pytest.fixture
def torch(gpu: Any) -> Any:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    if not torch.cuda.is_available():
        pytest.skip("PyTorch sees no GPU")
    torch.cuda._sleep(1)  # loaded now, not while something is timed
    torch.zeros(1, device="cuda:0").add_(1)
    return torch


@pytest.fixture
def cupy(gpu: Any, torch: Any) -> Any:
    return pytest.importorskip("cupy", reason="CuPy is not installed")


def busy(torch: Any, gpu: Any) -> None:
    """Hold up Warp's stream."""
    with torch.cuda.stream(torch.cuda.ExternalStream(gpu.stream.cuda_stream)):
        torch.cuda._sleep(DELAY)


@contextmanager
def on_stream_of(torch: Any, library: str) -> Iterator[None]:
    """Work of `library` goes to a stream of its own that waits for no other, and is held up."""
    if library == "torch":
        stream = torch.cuda.Stream()
        with torch.cuda.stream(stream):
            torch.cuda._sleep(DELAY)
            yield
        stream.synchronize()
    else:
        cupy = sys.modules["cupy"]
        stream = cupy.cuda.Stream(non_blocking=True)
        with torch.cuda.stream(torch.cuda.ExternalStream(stream.ptr)):
            torch.cuda._sleep(DELAY)
        with stream:
            yield
        stream.synchronize()


def to_gpu(torch: Any, library: str, values: np.ndarray) -> Any:
    if library == "torch":
        return torch.from_numpy(values).to("cuda:0")
    return sys.modules["cupy"].asarray(values)


def overwrite(library: str, array: Any, values: Any) -> None:
    if library == "torch":
        array.copy_(values)
    else:
        array[...] = values


@pytest.fixture(params=["torch", "cupy"])
def library(request: pytest.FixtureRequest, torch: Any) -> str:
    if request.param == "cupy":
        request.getfixturevalue("cupy")
    return request.param


@pytest.mark.parametrize("dtype", STORED)
def test_arrays_on_the_gpu_are_copied_there(
    torch: Any, library: str, dtype: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels, values = load("warp"), values_of(dtype, rng)
    image = kernels.zeros_image(SHAPE, "cuda:0", dtype)
    array = to_gpu(torch, library, values)
    turned = to_gpu(torch, library, np.ascontiguousarray(values.transpose(0, 3, 1, 2)))
    wide = to_gpu(torch, library, np.repeat(values, 2, axis=2))
    turned = turned.permute(0, 2, 3, 1) if library == "torch" else turned.transpose(0, 2, 3, 1)
    for source in (array, turned, wide[:, :, ::2]):
        kernels.upload(np.zeros(SHAPE, dtype), image)
        with monkeypatch.context() as without_the_host:
            for way in ("array", "asarray", "ascontiguousarray", "from_dlpack"):
                without_the_host.setattr(np, way, None)
            kernels.upload(source, image)
        np.testing.assert_array_equal(kernels.numpy(image), values)


def test_arrays_that_are_written_on_another_stream_are_waited_for(
    gpu: Any, torch: Any, library: str, rng: np.random.Generator
) -> None:
    import warp

    kernels, values = load("warp"), values_of("uint8", rng)
    array, source = to_gpu(torch, library, np.zeros_like(values)), to_gpu(torch, library, values)
    image, early = (kernels.zeros_image(SHAPE, "cuda:0", np.uint8) for _ in range(2))
    torch.cuda.synchronize()
    with on_stream_of(torch, library):
        overwrite(library, array, source)
        unordered = warp.array(ptr=array.__cuda_array_interface__["data"][0], dtype=early.dtype, shape=SHAPE[:3])
        warp.copy(early, unordered)
        kernels.upload(array, image)
    assert not kernels.numpy(early).any()
    np.testing.assert_array_equal(kernels.numpy(image), values)


@pytest.mark.parametrize("ordered", [True, False], ids=["upload", "by itself"])
def test_arrays_may_be_changed_when_they_are_uploaded(
    gpu: Any, torch: Any, library: str, ordered: bool, rng: np.random.Generator
) -> None:
    import warp

    kernels, values = load("warp"), values_of("uint8", rng)
    array, zeros = to_gpu(torch, library, values), to_gpu(torch, library, np.zeros_like(values))
    image = kernels.zeros_image(SHAPE, "cuda:0", np.uint8)
    flat = warp.array(ptr=array.__cuda_array_interface__["data"][0], dtype=image.dtype, shape=SHAPE[:3])
    torch.cuda.synchronize()
    stream = torch.cuda.Stream() if library == "torch" else sys.modules["cupy"].cuda.Stream(non_blocking=True)
    with torch.cuda.stream(stream) if library == "torch" else stream:
        busy(torch, gpu)
        if ordered:
            kernels.upload(array, image)
        else:
            warp.copy(image, flat)
        overwrite(library, array, zeros)
    stream.synchronize()
    np.testing.assert_array_equal(kernels.numpy(image), values if ordered else 0)


def test_pinned_memory_may_be_changed_when_it_is_uploaded(gpu: Any, torch: Any, rng: np.random.Generator) -> None:
    kernels, values = load("warp"), values_of("uint8", rng)
    pinned = torch.from_numpy(values).pin_memory().numpy()
    image = kernels.zeros_image(SHAPE, "cuda:0", np.uint8)
    busy(torch, gpu)
    kernels.upload(pinned, image)
    pinned[:] = 0
    np.testing.assert_array_equal(kernels.numpy(image), values)


def test_maps_are_read_when_they_are_there(gpu: Any, torch: Any, library: str) -> None:
    """On a stream that waits for no other; by the array interface also where nobody reads by DLPack."""
    kernels = load("warp")
    field = kernels.zeros((4, 5), "cuda:0")

    def readers() -> Iterator[Any]:
        shared = kernels.shared(field)
        if library == "torch":
            early = torch.utils.dlpack.from_dlpack(field.__dlpack__(stream=-1))
            yield lambda: early.clone()
            yield lambda: torch.from_dlpack(shared).clone()
        else:
            cupy = sys.modules["cupy"]
            early = cupy.asarray(field)
            yield lambda: early.copy()
            yield lambda: cupy.asarray(shared).copy()
            yield lambda: cupy.from_dlpack(shared).copy()

    found = []
    for read in readers():
        kernels.fill(0.0, field)
        torch.cuda.synchronize()
        stream = torch.cuda.Stream() if library == "torch" else sys.modules["cupy"].cuda.Stream(non_blocking=True)
        with torch.cuda.stream(stream) if library == "torch" else stream:
            read()  # what it takes the first time must not hold up the host
            torch.cuda.synchronize()
            busy(torch, gpu)
            kernels.fill(1.0, field)
            copy = read()
        stream.synchronize()
        found.append(float(copy.min()))
    assert found[0] == 0.0
    assert found[1:] == [1.0] * (len(found) - 1)


def test_frames_of_torch_become_maps_of_torch(gpu: Any, torch: Any) -> None:
    """On a stream of PyTorch, in a buffer that is used for all of them; the host never waits."""
    target = type("Target", (), {"backend": "warp", "device": "cuda:0"})
    wanted = []
    for seed in range(4):
        alone = made(scene(seed), target)
        alone.run()
        wanted.append((alone.disparity(), alone.result().confidence))
    pipeline, maps = made(scene(), target), []
    frames = [torch.from_numpy(scene(seed).views).to("cuda:0") for seed in range(4)]
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream()):
        buffer = torch.empty_like(frames[0])
        for frame in frames:
            torch.cuda._sleep(DELAY // 10)
            buffer.copy_(frame)
            pipeline.upload(buffer)
            pipeline.run()
            both = (pipeline.device_disparity, pipeline.device_confidence)
            maps.append([torch.from_dlpack(there).clone() for there in both])
    torch.cuda.synchronize()
    for got, want in zip(maps, wanted, strict=True):
        for one, other in zip(got, want, strict=True):
            assert np.median(np.abs(one.cpu().numpy() - other)) <= SAME


def test_views_on_the_gpu_that_are_not_finite_have_no_map(gpu: Any, torch: Any) -> None:
    target = type("Target", (), {"backend": "warp", "device": "cuda:0"})
    lf = scene(dtype="float32")
    pipeline = made(lf, target)
    pipeline.run()
    want = pipeline.disparity()
    for index in (0, lf.reference_index):
        for value in (np.nan, np.inf):
            views = torch.from_numpy(lf.views).to("cuda:0")
            views[index, 10, 12, 1] = value
            pipeline.upload(views)
            pipeline.run()
            for ask in (pipeline.disparity, pipeline.result):
                with pytest.raises(LightFieldError, match="views hold NaN or infinity"):
                    ask()
    pipeline.upload(torch.from_numpy(lf.views).to("cuda:0"))
    pipeline.run()
    assert np.median(np.abs(pipeline.disparity() - want)) <= SAME


def test_what_cannot_go_to_a_gpu_is_said_in_one_sentence(gpu: Any, torch: Any) -> None:
    target = type("Target", (), {"backend": "warp", "device": "cuda:0"})
    views = torch.from_numpy(scene(dtype="float32").views).to("cuda:0")
    pipeline = made(scene(dtype="float32"), target)
    kind = "views must be float32 [15, 32, 36, 3], like those that the pipeline was made for; found"
    for wrong, sentence in (
        (views.to(torch.uint8), f"{kind} uint8 [15, 32, 36, 3]."),
        (views.to(torch.bfloat16), f"{kind} bfloat16 [15, 32, 36, 3]."),
        (views.permute(0, 3, 1, 2), f"{kind} float32 [15, 3, 32, 36]."),
        (
            Elsewhere(scene(dtype="float32").views, (2, 7)),
            "views are on cuda:7, but the pipeline is on cuda:0; copy them there first.",
        ),
    ):
        with pytest.raises(LightFieldError) as error:
            pipeline.upload(wrong)
        assert str(error.value) == sentence
    with pytest.raises(LightFieldError, match=r"^views cannot be read: .*gradient"):
        pipeline.upload(views.clone().requires_grad_())
    on_cpu = made(scene(dtype="float32"), type("Target", (), {"backend": "warp", "device": "cpu"}))
    with pytest.raises(LightFieldError, match=r"^views are on cuda:0, but the pipeline is on cpu"):
        on_cpu.upload(views)


def test_a_light_field_takes_arrays_of_a_gpu(torch: Any, library: str) -> None:
    lf = scene()
    np.testing.assert_array_equal(LightField(to_gpu(torch, library, lf.views), lf.positions).views, lf.views)

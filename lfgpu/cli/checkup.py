"""Examination of an installation for `lfgpu doctor`: versions, devices, kernel caches, memory, optional parts, a
self-test.
"""

import importlib
import importlib.metadata
import multiprocessing
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendInfo, BackendName, backend_named, describe_backends, load
from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LfgpuError
from lfgpu.io import read, read_map, save, write_hci
from lfgpu.io.damage import how_to_install, physical_memory
from lfgpu.io.frames import write_frames, write_image
from lfgpu.io.images import read_image
from lfgpu.io.png import write_png
from lfgpu.machine import device_memory, device_name, free_memory, version_of
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.scenes import make
from lfgpu.threads import get_threads

Difference = float
"""The largest difference between what was written and what was read."""


def _exr(lf: LightField, place: Path) -> Difference:
    disparity = lf.image(0)[..., 0]
    save(DisparityMap(disparity), place / "map.exr")
    return _apart(read_map(place / "map.exr"), disparity)


def _hdf5(lf: LightField, place: Path) -> Difference:
    import h5py

    views = lf.views.reshape(*(lf.grid_shape or ()), *lf.views.shape[1:])
    with h5py.File(place / "views.h5", "w") as file:
        file["LF"] = views
    return _apart(read(place / "views.h5").views, lf.views)


def _tiff(lf: LightField, place: Path) -> Difference:
    write_image(lf.image(0), place / "view.tif")
    return _apart(read_image(place / "view.tif")[0], lf.image(0))


def _png(lf: LightField, place: Path) -> Difference:
    write_png(place / "view.png", lf.views[0])
    return _apart(read_image(place / "view.png")[0], lf.views[0])


def _video(lf: LightField, place: Path) -> Difference:
    write_frames((lf.image(index) for index in range(3)), place / "film.mp4")
    found = read(place / "film.mp4").views / 255
    return max(0.0, float(abs(found - lf.views[:3] * lf.scale).mean()) - _LOSS)


def _calibration(lf: LightField, place: Path) -> Difference:
    from lfgpu.calibration.formats.entries import read_yaml

    (place / "cameras.yml").write_text("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 1\n   data: [ 1., 2.5 ]\n")
    return _apart(read_yaml(place / "cameras.yml")["K"]["data"], [1, 2.5])


def _viewer(lf: LightField, place: Path) -> Difference:
    from urllib.request import urlopen

    from lfgpu.viewer import Viewer

    _imported("viser")
    with Viewer(port=0) as viewer, urlopen(viewer.url, timeout=_PATIENCE) as answer:
        return float(answer.status != 200)


def _imported(*modules: str) -> Difference:
    for module in modules:
        importlib.import_module(module)
    return 0.0


def _apart(found: Any, expected: NDArray[Any] | list[float]) -> Difference:
    return float(np.abs(np.asarray(found, float) - np.asarray(expected, float)).max())


_LOSS = 0.05  # intensity, on average: films are compressed
_PATIENCE = 60  # seconds

TRIALS: dict[str, Callable[[LightField, Path], Difference]] = {
    "batch": lambda *_: _imported("distributed", "cryptography.x509"),
    "calibration": _calibration,
    "exr": _exr,
    "hdf5": _hdf5,
    "opencv": lambda *_: _imported("cv2"),
    "png": _png,
    "tiff": _tiff,
    "train": lambda *_: _imported("torch"),
    "video": _video,
    "viewer": _viewer,
    "xarray": lambda *_: _imported("xarray"),
}
"""The trial of each part but those that are backends, of a light field in a folder; it may raise anything."""


PARTS = {
    "batch": "many light fields with `lfgpu batch`",
    "calibration": "calibrations of OpenCV and Kalibr as YAML",
    "exr": "maps as OpenEXR, light fields of Blender",
    "hdf5": "old HCI light fields, MATLAB 7.3 files",
    "opencv": "cameras of OpenCV as live sources",
    "png": "PNG files, faster",
    "taichi": "a second backend",
    "tiff": "TIFF files",
    "train": "weights for a rig with `lfgpu train`",
    "video": "videos as input, films as MP4",
    "viewer": "the viewer in the browser",
    "xarray": "light fields and maps as xarray datasets",
}
"""Purposes of the extras of the package. Those of developers are left out."""

_SCENE, _GRID, _SIZE, _RANGE = "relief", (5, 5), (64, 80), (-1.5, 1.5)
_EXACT = 1e-6  # intensity or px per view step: what is written without loss
_FROM_TRUTH = 0.03  # px per view step: three times the median error that a working backend has on the scene
_FROM_REFERENCE = 1e-3  # px per view step, in the median


@dataclass(frozen=True)
class Trial:
    """One step of the self-test."""

    what: str
    seconds: float
    from_truth: float | None = None  # median distance of the map from the ground truth, px per view step
    from_reference: float | None = None
    """Median distance of the map from that of the reference backend, px per view step."""
    problem: str | None = None

    def __str__(self) -> str:
        if self.problem:
            return f"failed after {self.seconds:.1f} s"
        distances = (("ground truth", self.from_truth), ("reference", self.from_reference))
        told = (f", {distance:.1g} px from the {what}" for what, distance in distances if distance is not None)
        return f"passed in {self.seconds:.1f} s{''.join(told)}"


@dataclass(frozen=True)
class Checkup:
    """All that was found: labels and texts by title, the trials, and a sentence for each problem."""

    facts: dict[str, list[tuple[str, str]]]
    trials: tuple[Trial, ...]
    problems: tuple[str, ...]


def examine() -> Checkup:
    """Examine the installation and run the self-test."""
    backends = describe_backends()
    caches = {
        info.name: Path(folder)
        for info in backends
        if info.problem is None and (folder := load(info.name).kernel_cache()) is not None
    }
    missing = {extra: [name for name in sorted(needed(extra)) if version_of(name) is None] for extra in PARTS}
    trials = tuple(_trials(backends, [extra for extra, lost in missing.items() if not lost]))
    facts = {
        "Versions": list(_versions()),
        "Devices": [(info.name, _device(device)) for info in backends for device in info.devices],
        "Kernel cache": [(name, f"{folder}, {_size(_bytes_in(folder))}") for name, folder in caches.items()],
        "Memory": list(_memory()),
        "Optional parts": [(extra, _part(extra, lost)) for extra, lost in missing.items()],
        "Self-test": [(trial.what, str(trial)) for trial in trials],
    }
    unwritable = (_of_cache(name, folder) for name, folder in caches.items() if not _writable(folder))
    told = (trial.problem for trial in trials if trial.problem)
    return Checkup(facts, trials, (*_of_backends(backends), *unwritable, *told))


# --- what is there ---


def _versions() -> Iterator[tuple[str, str]]:
    """Yield the versions of lfgpu, Python, the system, and the packages that lfgpu cannot do without."""
    yield "lfgpu", version_of("lfgpu") or "not installed"
    yield "python", platform.python_version()
    yield "system", platform.platform()
    for name in sorted(needed(None)):
        yield name, version_of(name) or "not installed"


def needed(extra: str | None) -> set[str]:
    """Return the packages that lfgpu asks for: those of an extra, or, for None, those that it cannot do without."""
    found = set()
    for line in importlib.metadata.requires("lfgpu") or () if version_of("lfgpu") else ():
        name, of = re.match(r"[\w.-]+", line), re.search(r"extra == ['\"](\w+)['\"]", line)
        if name and name[0] != "lfgpu" and (of[1] if of else None) == extra:
            found.add(name[0])
    return found


def _device(device: str) -> str:
    memory = device_memory(device)
    return ": ".join(filter(None, [device, device_name(device)])) + (f", {_size(memory)}" if memory else "")


def _memory() -> Iterator[tuple[str, str]]:
    sizes = {"machine": physical_memory(), "free": free_memory()}
    yield from ((label, _size(size) if size else "unknown") for label, size in sizes.items())
    yield "temporary files", f"{_size(shutil.disk_usage(tempfile.gettempdir()).free)} free"
    yield "threads", str(get_threads())


def _part(extra: str, missing: list[str]) -> str:
    return f"not installed: {PARTS[extra]}; pip install 'lfgpu[{extra}]'" if missing else f"installed: {PARTS[extra]}"


def _bytes_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _writable(folder: Path) -> bool:
    """Tell whether files can be written in a folder, or the folder be made if it is not there."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _size(size: int) -> str:
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.1f} MiB"


# --- what is wrong ---


def _of_backends(backends: tuple[BackendInfo, ...]) -> Iterator[str]:
    """Yield the problems of backends; one that is not installed is no problem, but for the default one."""
    for info in backends:
        if info.problem is not None and (info.version is not None or info.name == DEFAULT):
            remedy = f"; run: {info.remedy}" if info.remedy else ""
            yield f"The backend {info.name} {info.problem.rstrip('.')}{remedy}."


def _of_cache(backend: str, folder: Path) -> str:
    return (
        f"The backend {backend} cannot keep compiled kernels in {folder}: make this folder writable, or "
        "name another one (WARP_CACHE_PATH for Warp, TI_OFFLINE_CACHE_FILE_PATH for Taichi)."
    )


# --- whether it works ---


def _trials(backends: tuple[BackendInfo, ...], extras: Iterable[str]) -> Iterator[Trial]:
    """Try files of all formats whose packages are there, then an estimate on each device, the reference first."""
    lf = make(_SCENE, grid=_GRID, size=_SIZE, disparity_range=_RANGE)
    yield _files(lf)
    for extra in extras:
        if extra in TRIALS:
            yield _of_part(extra, lf)
    expected: NDArray[Any] | None = None
    for info in sorted(backends, key=lambda info: info.name != "reference"):
        for device in info.devices:
            # Taichi runs on one device per process, the first that is asked for.
            apart = info.name == "taichi" and device != info.devices[0]
            trial, found = (_estimate_apart if apart else _estimate)(lf, backend_named(info.name), device, expected)
            expected = found if expected is None else expected
            yield trial


def _files(lf: LightField) -> Trial:
    start = perf_counter()
    problem = None
    try:
        with tempfile.TemporaryDirectory() as folder:
            write_hci(lf, Path(folder) / "views")
            found = read(Path(folder) / "views")
        if np.abs(found.views * found.scale - lf.views * lf.scale).max() > 1 / 255:
            problem = "A light field that was written and read again has other pixels."
    except (LfgpuError, OSError) as error:
        problem = f"A light field cannot be written to {tempfile.gettempdir()} and read again ({error})."
    return Trial("files", perf_counter() - start, problem=problem)


def _of_part(extra: str, lf: LightField) -> Trial:
    start, said = perf_counter(), ""
    try:
        with tempfile.TemporaryDirectory() as folder:
            apart = TRIALS[extra](lf, Path(folder))
        if not apart <= _EXACT:
            said = f"what is read differs by {apart:.3g} from what was written"
    except Exception as error:  # what a library raises that does not fit is anything
        said = (" ".join(str(error).split()) or type(error).__name__).rstrip(".")
    needs = ", ".join(f"{name} {version_of(name)}" for name in sorted(needed(extra)))
    problem = f"The part {extra} does not work with {needs} ({said}); {how_to_install(extra)}." if said else None
    return Trial(f"extra {extra}", perf_counter() - start, problem=problem)


def _estimate_apart(
    lf: LightField, backend: BackendName, device: str, expected: NDArray[Any] | None
) -> tuple[Trial, NDArray[Any] | None]:
    """Estimate in a process of its own."""
    start = perf_counter()
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            return process.submit(_estimate, lf, backend, device, expected).result()
    except BrokenExecutor:
        what = f"{backend} on {device}"
        return Trial(what, perf_counter() - start, problem=f"The estimate by {what} ended its process."), None


def _estimate(
    lf: LightField, backend: BackendName, device: str, expected: NDArray[Any] | None
) -> tuple[Trial, NDArray[Any] | None]:
    what, start = f"{backend} on {device}", perf_counter()
    try:
        found = estimate_depth(
            lf, config="fast", backend=backend, device=device, disparity_range=_RANGE, check_cameras=False
        ).disparity
    except Exception as error:  # what a broken driver or compiler raises is anything
        said = " ".join(str(error).split()) or type(error).__name__
        return Trial(what, perf_counter() - start, problem=f"The estimate by {what} failed: {said.rstrip('.')}."), None
    seconds = perf_counter() - start
    truth = lf.reference_truth()
    assert truth is not None  # synthetic scenes have it
    errors = [float(np.median(np.abs(found - truth.disparity)))]
    errors += [] if expected is None else [float(np.median(np.abs(found - expected)))]
    wrong = [error for error, most in zip(errors, (_FROM_TRUTH, _FROM_REFERENCE), strict=False) if not error <= most]
    problem = f"The map by {what} is wrong by {max(errors):.3g} px in the median." if wrong else None
    return Trial(what, seconds, errors[0], errors[1] if expected is not None else None, problem), found

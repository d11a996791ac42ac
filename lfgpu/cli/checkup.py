"""Examination of an installation for `lfgpu doctor`: versions, devices, kernel caches, memory, optional parts, a
self-test.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import multiprocessing
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendInfo, BackendName, backend_named, describe_backends, load
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
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
class Device:
    """A device that a backend can use."""

    backend: str
    device: str
    name: str | None
    memory_bytes: int | None


@dataclass(frozen=True)
class Cache:
    """The folder in which a backend keeps compiled kernels."""

    backend: str
    folder: str
    bytes: int
    writable: bool


@dataclass(frozen=True)
class Part:
    """An optional part of the package."""

    extra: str
    purpose: str
    missing: tuple[str, ...]
    """The packages that it needs and that are not installed."""


@dataclass(frozen=True)
class Trial:
    """One step of the self-test."""

    what: str
    seconds: float
    from_truth: float | None = None
    """Median distance of the map from the ground truth, px per view step."""
    from_reference: float | None = None
    """Median distance of the map from that of the reference backend, px per view step."""
    problem: str | None = None


@dataclass(frozen=True)
class Checkup:
    """All that was found, and a sentence for each problem."""

    versions: dict[str, str]
    devices: tuple[Device, ...]
    caches: tuple[Cache, ...]
    memory: dict[str, int | None]
    """Bytes of the machine, of it those that are free, and the room for temporary files; None if unknown."""
    threads: int
    parts: tuple[Part, ...]
    trials: tuple[Trial, ...]
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return all of it in dictionaries, lists, texts and numbers."""
        return asdict(self)


def examine() -> Checkup:
    """Examine the installation and run the self-test."""
    backends = describe_backends()
    caches, parts = tuple(_caches(backends)), tuple(_parts())
    trials = tuple(_trials(backends, parts))
    return Checkup(
        _versions(),
        tuple(_devices(backends)),
        caches,
        _memory(),
        get_threads(),
        parts,
        trials,
        (
            *_of_backends(backends),
            *(_of_cache(cache) for cache in caches if not cache.writable),
            *(trial.problem for trial in trials if trial.problem),
        ),
    )


# --- what is there ---


def _versions() -> dict[str, str]:
    """Return the versions of lfgpu, Python, the system, and the packages that lfgpu cannot do without."""
    needed = sorted({name for name, extra in _requirements() if extra is None})
    return {
        "lfgpu": version_of("lfgpu") or "not installed",
        "python": platform.python_version(),
        "system": platform.platform(),
        **{name: version_of(name) or "not installed" for name in needed},
    }


def _requirements() -> Iterator[tuple[str, str | None]]:
    """Yield the packages that lfgpu asks for, each with the extra that it belongs to."""
    for line in importlib.metadata.requires("lfgpu") or () if version_of("lfgpu") else ():
        name, extra = re.match(r"[\w.-]+", line), re.search(r"extra == ['\"](\w+)['\"]", line)
        if name and name[0] != "lfgpu":
            yield name[0], extra[1] if extra else None


def _parts() -> Iterator[Part]:
    for extra, purpose in PARTS.items():
        needed = sorted({name for name, of in _requirements() if of == extra})
        yield Part(extra, purpose, tuple(name for name in needed if version_of(name) is None))


def _devices(backends: tuple[BackendInfo, ...]) -> Iterator[Device]:
    for info in backends:
        for device in info.devices:
            yield Device(info.name, device, device_name(device), device_memory(device))


def _caches(backends: tuple[BackendInfo, ...]) -> Iterator[Cache]:
    for info in backends:
        folder = load(info.name).kernel_cache() if info.problem is None else None
        if folder is not None:
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            yield Cache(info.name, folder, sum(path.stat().st_size for path in files), _writable(Path(folder)))


def _writable(folder: Path) -> bool:
    """Tell whether files can be written in a folder, or the folder be made if it is not there."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _memory() -> dict[str, int | None]:
    return {
        "machine": physical_memory() or None,
        "free": free_memory(),
        "temporary files": shutil.disk_usage(tempfile.gettempdir()).free,
    }


# --- what is wrong ---


def _of_backends(backends: tuple[BackendInfo, ...]) -> Iterator[str]:
    """Yield the problems of backends; one that is not installed is no problem, but for the default one."""
    for info in backends:
        if info.problem is not None and (info.version is not None or info.name == DEFAULT):
            remedy = f"; run: {info.remedy}" if info.remedy else ""
            yield f"The backend {info.name} {info.problem.rstrip('.')}{remedy}."


def _of_cache(cache: Cache) -> str:
    return (
        f"The backend {cache.backend} cannot keep compiled kernels in {cache.folder}: make this folder writable, or "
        "name another one (WARP_CACHE_PATH for Warp, TI_OFFLINE_CACHE_FILE_PATH for Taichi)."
    )


# --- whether it works ---


def _trials(backends: tuple[BackendInfo, ...], parts: tuple[Part, ...]) -> Iterator[Trial]:
    """Try files of all formats whose packages are there, then an estimate on each device, the reference first."""
    lf = make(_SCENE, grid=_GRID, size=_SIZE, disparity_range=_RANGE)
    yield _files(lf)
    for part in parts:
        if not part.missing and part.extra in TRIALS:
            yield _of_part(part.extra, lf)
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
    needs = ", ".join(f"{name} {version_of(name)}" for name, of in _requirements() if of == extra)
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

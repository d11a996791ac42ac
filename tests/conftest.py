"""Fixtures of all tests: backends and devices that are tried, the seed of random inputs, real light fields."""

import gc
import os
import pickle
import secrets
import shutil
from collections.abc import Iterator
from functools import partial, wraps
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from lfgpu._backends import DEFAULT, list_backends, load
from lfgpu.contract import Device, KernelSet
from lfgpu.data import LightField
from lfgpu.errors import BackendError
from lfgpu.io import write_hci
from lfgpu.pipelines import verdict
from lfgpu.pipelines.resident import KEPT, kept_memory
from lfgpu.scenes import synthesis
from lfgpu.threads import get_threads

SEED = "LFGPU_TEST_SEED"
DATA = Path(os.environ.get("LFGPU_DATA") or Path(__file__).parents[2] / "shared" / "data")


class Target(NamedTuple):
    """A backend on a device, or the reason why it cannot be tried here."""

    backend: str
    device: str
    kernels: KernelSet | None
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.backend}-{self.device}"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("lfgpu")
    group.addoption("--backend", help="try the kernels of this backend only (the reference is always what is true)")
    group.addoption("--device", help='try the kernels on this device only: "cpu", "cuda", "cuda:1"')
    group.addoption("--seed", type=int, help=f"seed of random inputs; else ${SEED}, else a new one for each run")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "thorough: left out by `make test`, run by `make test-all`")
    config.addinivalue_line("markers", "special: thorough by other backends than the default and the reference")
    config.addinivalue_line("markers", "data(folder): needs the real light field in that folder of $LFGPU_DATA")
    given = config.getoption("--seed")
    # By way of the environment, so that all workers of pytest-xdist have the same one.
    os.environ[SEED] = str(given) if given is not None else os.environ.get(SEED) or str(secrets.randbits(32))
    _share_cores()
    wanted = config.getoption("--backend"), config.getoption("--device")
    # The process that starts the workers of pytest-xdist runs no test: it need not load what takes seconds.
    starts_workers = getattr(config.option, "dist", "no") != "no" and not hasattr(config, "workerinput")
    if not starts_workers:
        gc.disable()  # until all tests are collected: there is nothing to free
    config.stash[_TARGETS] = [] if starts_workers and not any(wanted) else list(_find_targets(*wanted))
    _refuse_nothing(config.stash[_TARGETS], *wanted)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Start one worker more than there are cores: now and then each waits for a process or a browser."""
    return get_threads() + 1


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no module of which `make test` leaves out all tests: some need packages that take seconds to load."""
    if config.option.markexpr != "not thorough" or collection_path.suffix != ".py":
        return None
    return True if "\npytestmark = pytest.mark.thorough\n" in collection_path.read_text(encoding="utf-8") else None


def pytest_collection_finish() -> None:
    """Leave modules and thousands of tests out of all collections of garbage, of which each pipeline needs one."""
    gc.freeze()
    gc.enable()


_TARGETS = pytest.StashKey[list[Target]]()


def _share_cores() -> None:
    """Each worker of pytest-xdist has its share of the cores: with more threads than cores they wait for each other."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if workers > 1:
        share = max(1, get_threads() // workers)
        os.environ.setdefault("LFGPU_THREADS", str(share))
        threadpool_limits(share)


def _find_targets(only_backend: str | None, only_device: str | None) -> Iterator[Target]:
    wanted_device = "cuda:0" if only_device == "cuda" else only_device
    for backend in list_backends():
        if only_backend not in (None, backend):
            yield Target(backend, only_device or "any device", None, f"--backend={only_backend}")
            continue
        try:
            kernels = load(backend)
        except BackendError as error:
            yield Target(backend, only_device or "any device", None, str(error))
            continue
        devices = kernels.devices()
        # A GPU is named where there is none, so that a run without one says what it did not try.
        expected = [*devices, *({"cuda:0"} - set(devices) if backend != "reference" else ()), wanted_device]
        for device in dict.fromkeys(name for name in expected if name):
            if wanted_device not in (None, device):
                yield Target(backend, device, None, f"--device={only_device}")
            elif device not in devices:
                yield Target(backend, device, None, f"no such device here; there is {', '.join(devices)}")
            else:
                yield _started(Target(backend, device, kernels))
    if only_backend is not None and only_backend not in list_backends():
        raise pytest.UsageError(f"--backend={only_backend}: there are {', '.join(list_backends())}")


def _refuse_nothing(targets: list[Target], only_backend: str | None, only_device: str | None) -> None:
    """A run that was to try a backend or device and cannot is an error: with all tests skipped it would look right."""
    if (only_backend or only_device) and not any(target.kernels for target in targets):
        wanted = [target for target in targets if not target.reason.startswith("--")]
        reasons = "; ".join(f"{target}: {target.reason}" for target in wanted)
        raise pytest.UsageError(f"what --backend and --device name cannot be tried here ({reasons})")


def _started(target: Target) -> Target:
    """The target if an array can be made there: a backend may run on one device per process, the first asked for."""
    try:
        target.kernels.zeros((1,), target.device)
    except BackendError as error:
        return target._replace(kernels=None, reason=str(error))
    return target


def pytest_report_header(config: pytest.Config) -> list[str]:
    targets = config.stash[_TARGETS]
    backends, devices = (max((len(target[column]) for target in targets), default=0) for column in (0, 1))
    table = [
        f"  {target.backend:<{backends}}  {target.device:<{devices}}  "
        + (f"not tried: {target.reason}" if target.kernels is None else "tried")
        for target in targets
    ]
    data = f"{DATA}" if DATA.is_dir() else f"{DATA} is not there: tests on real light fields are skipped"
    heading = "kernels:" if table else "kernels: of all backends; what is not here is among the skipped tests"
    return [heading, *table, f"random inputs: --seed={os.environ[SEED]}", f"data: {data}"]


@pytest.hookimpl(trylast=True)
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`target`: each backend x device that can be tried; `other`: those but the reference; `named`: all.

    Outside of tests/kernels, which hold each operation of each backend, all but the default backend are thorough; and
    in the matrix there all but the first cases of each operation (`special`).
    Comes last, so that what one case needs is computed once for all of them, and in one worker of pytest-xdist.
    """
    targets = metafunc.config.stash[_TARGETS]
    there = [target for target in targets if target.kernels is not None]
    chosen = {
        "target": there,
        "other": [target for target in there if target.backend != "reference"],
        "named": [target if target.kernels else _skipped(target) for target in targets],
    }
    in_kernels = metafunc.definition.path.parent.name == "kernels"
    for name, values in chosen.items():
        own = any(name in mark.args[0] for mark in metafunc.definition.iter_markers("parametrize"))
        if name in metafunc.fixturenames and not own:
            metafunc.parametrize(name, values if in_kernels else [_everyday(value) for value in values], ids=str)


def _everyday(target: Any) -> Any:
    """A parameter that is thorough if its backend is not the default."""
    is_default = not isinstance(target, Target) or target.backend == DEFAULT
    return target if is_default else pytest.param(target, marks=pytest.mark.thorough)


def pytest_itemcollected(item: pytest.Item) -> None:
    """In a browser, all but what everybody sees of the viewer is thorough; `special` tests are by other backends."""
    in_browser = "browser" in getattr(item, "fixturenames", ())
    given = item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
    target = given.get("other", given.get("target"))
    by_another = isinstance(target, Target) and target.backend not in (DEFAULT, "reference")
    special = by_another and item.get_closest_marker("special") is not None
    if special or (in_browser and item.path.name not in ("test_looking.py", "test_banner.py")):
        item.add_marker(pytest.mark.thorough)


def _skipped(target: Target) -> Any:
    return pytest.param(target, marks=pytest.mark.skip(reason=f"{target}: {target.reason}"))


@pytest.fixture(autouse=True)
def nothing_kept(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No pipeline is one of another test; captures are decoded in each, and the cache of the user stays as it is.

    Only what views say of themselves is kept, but for the tests that are about it: it takes longer than most maps do.
    """
    if kept_memory():
        KEPT.free()
        gc.freeze()  # the collections of further tests leave out what stayed: modules, caches of tests
    place = tmp_path_factory.getbasetemp() / f"decoded-{secrets.token_hex(4)}"
    monkeypatch.setattr("lfgpu.io.lenslet.entry.folder", lambda: place)
    if request.path.parent.name != "calibration":
        for name in ("look", "find_disparity_range"):
            monkeypatch.setattr(verdict, name, partial(_seen_once, getattr(verdict, name)))


@pytest.fixture
def _no_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras are not looked at: that takes longer than all else that `info` does."""
    monkeypatch.setattr(verdict, "look", lambda *_, **__: None)


_SEEN: dict[bytes, Any] = {}


def _seen_once(see: Any, lf: LightField, *arguments: Any, **options: Any) -> Any:
    """What a function sees in a light field, whatever its name, is what it saw in one of the same views before."""
    views = [np.asarray(lf.views).tobytes(), lf.views.shape, lf.views.dtype, lf.positions.tolist(), lf.reference]
    known = None if lf.valid is None or lf.valid.all() else lf.valid
    told = [(value.kernels.name, value.name) if isinstance(value, Device) else value for value in arguments]
    key = sha256(pickle.dumps((see.__name__, views, known, lf.grid_shape, told, options))).digest()
    if key not in _SEEN:
        _SEEN[key] = see(lf, *arguments, **options)
    return _SEEN[key]


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that are new in each run and, for a given seed, the same for each test whatever else is run."""
    return np.random.default_rng([int(os.environ[SEED]), *request.node.nodeid.encode()])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[Any]:
    report = yield
    if report.failed and "rng" in getattr(item, "fixturenames", ()):
        report.sections.append(("random inputs", f"the same ones again: pytest --seed={os.environ[SEED]}"))
    return report


@pytest.fixture(scope="session", autouse=True)
def _scenes_are_drawn_once(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep light fields of scenes for other tests, workers and runs, until the code that draws them changes.

    To draw them takes longer than most of what is done with them.
    """
    draw, cache = synthesis._record, getattr(request.config, "cache", None)  # there is none with -p no:cacheprovider
    package = Path(synthesis.__file__).parents[1]
    code = [path.read_bytes() for room in ("scenes", "data") for path in sorted((package / room).glob("*.py"))]
    state = sha256(b"".join([np.__version__.encode(), *code])).hexdigest()
    kept = cache.mkdir("scenes") if cache else tmp_path_factory.mktemp("scenes")
    for other in {*kept.iterdir()} - {kept / state}:
        shutil.rmtree(other, ignore_errors=True)

    @wraps(draw)
    def record(scene: Any, *how: Any) -> LightField:
        told = [part.tolist() if isinstance(part, np.ndarray) else part for part in how]
        named = repr((scene.name, scene.grid, scene.frame, scene.seed, told))
        file = kept / state / sha256(named.encode()).hexdigest()
        try:
            content = file.read_bytes()
        except FileNotFoundError:  # another run, of another NumPy, may have removed the folder, too
            content = pickle.dumps(draw(scene, *how))
            file.parent.mkdir(parents=True, exist_ok=True)
            written = file.with_name(secrets.token_hex(8))
            written.write_bytes(content)
            written.replace(file)
        found: LightField = pickle.loads(content)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthesis, "_record", record)
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small scene as an HCI folder; tests that change it take `views`."""
    from command_line import boxes  # imports all commands, which most tests do not need

    folder = tmp_path_factory.mktemp("recorded") / "boxes"
    write_hci(boxes(), folder)
    return folder


@pytest.fixture(scope="session")
def true() -> LightField:
    """The light field that samples of all formats are written from, for tests/io."""
    from fields import scene

    return scene()


@pytest.fixture(scope="session")
def scene_folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of light fields for batches, one of which cannot be read."""
    from batch_runs import record

    return record(tmp_path_factory.mktemp("recorded") / "scenes")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for all tests of a file: it takes long to come."""
    from tests.browser import chromium

    with chromium() as opened:
        yield opened


@pytest.fixture
def views(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the views, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "views"))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A place for outputs whose parent is not there yet."""
    return tmp_path / "deep" / "out"


@pytest.fixture
def _permissions_count(tmp_path: Path) -> None:
    """Skips where this user may do what permissions forbid."""
    closed = tmp_path / "closed.txt"
    closed.touch(mode=0)
    if os.access(closed, os.R_OK):
        pytest.skip("this user may read and write everything (root)")
    closed.unlink()


@pytest.fixture(autouse=True)
def _needs_data(request: pytest.FixtureRequest) -> None:
    marker = request.node.get_closest_marker("data")
    if marker is not None:
        real_data(*marker.args)


@pytest.fixture
def data_folder(request: pytest.FixtureRequest) -> Path:
    """The folder that the test's `data` marker names."""
    marker = request.node.get_closest_marker("data")
    assert marker is not None, "data_folder needs @pytest.mark.data(folder)"
    return real_data(*marker.args)


def real_data(name: str) -> Path:
    """The file or folder of that name in the real light fields; skips where it is not there."""
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not there: set LFGPU_DATA to the folder of the real light fields")
    return DATA / name

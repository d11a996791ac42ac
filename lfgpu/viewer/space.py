"""The points or the surface of a map in space, for one tab: a scene of viser that a page shows in a frame."""

from __future__ import annotations

import logging
import math
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http import HTTPStatus
from itertools import count
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.frames import write_frames
from lfgpu.viewer import saving
from lfgpu.viewer.board import Board
from lfgpu.viewer.cloud import Cloud, nearest_to_ray, shown_cloud, surface
from lfgpu.viewer.contents import QUANTITIES, Contents
from lfgpu.viewer.glb import surface_glb
from lfgpu.viewer.place import HOST
from lfgpu.viewer.scene import Scene
from lfgpu.viz.colours import LOOKS, painted
from lfgpu.viz.panels import SLOPE, encoded, rgb
from lfgpu.viz.pictures import beside_scale

PICTURES = 48
"""Pictures of a film."""

_ASIDE, _ABOVE = math.radians(20), math.radians(8)  # of an orbit: how far it goes either way
_EXPOSURE = 30.0  # at most, either way: every stored value is white or black before
_LIVE_CLOUD = 0.5  # seconds between two point clouds of a stream
_ORBIT, _ORBIT_STEP = 9.0, 0.04  # seconds of an orbit, and between two of its steps
_SIDES = {"picture": 4096, "mp4": 1280, "gif": 640}  # pixels of the longer side of what is saved, at most
_MESH_POINTS = 120_000  # of a surface
_PAGES = {"light": (255, 255, 255), "dark": (20, 23, 28), "white": (255, 255, 255), "black": (0, 0, 0)}
_CAMERAS = {False: (130, 138, 148), True: SLOPE}  # the reference camera stands out
_BESIDE = (0.22, -0.14, 0.02)  # where the first eye stands, in distances of the cloud from the reference camera
_BEHIND = (0.12, -0.09, -0.3)  # the same where the cameras are to be seen, too
_NEAR = 3.0  # the cloud counts as not farther than so many times its nearest points, for these distances
_WIDEST, _STEPS_BACK = 1.2, 12  # tangent of half the largest angle of view: the eye steps back rather than see more

_UNHEARD = logging.getLogger("lfgpu.viewer.space")  # else nonsense from others is on the terminal
_UNHEARD.setLevel(logging.CRITICAL)
_starting = threading.Lock()  # one server at a time is guarded while it starts


@dataclass(frozen=True)
class Pose:
    """An eye: its place, what it looks at, and its vertical field of view in radians. Its y axis points down."""

    eye: NDArray[np.float64]
    target: NDArray[np.float64]
    fov: float = 1.0

    @classmethod
    def of(cls, camera: Any) -> Pose:
        """Return the pose of a camera of viser."""
        return cls(np.array(camera.position), np.array(camera.look_at), camera.fov)

    @property
    def away(self) -> float:
        """The distance of what it looks at."""
        return float(np.linalg.norm(self.target - self.eye))

    @property
    def axes(self) -> NDArray[np.float64]:
        """[3, 3], its directions right, down and forward as columns."""
        forward = (self.target - self.eye) / self.away
        right = np.cross((0.0, 1.0, 0.0), forward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward], axis=1)

    def orbited(self, turn: float) -> Pose:
        """Move the eye around what it looks at: to both sides in one turn, up and down twice; 0 and 1 are here."""
        aside, down = _ASIDE * math.sin(2 * math.pi * turn), _ABOVE * math.sin(4 * math.pi * turn)
        by = (math.cos(down) * math.sin(aside), math.sin(down), -math.cos(down) * math.cos(aside))
        return Pose(self.target + self.away * self.axes @ by, self.target, self.fov)


class Space:
    """A scene of viser and the thread that draws the newest wish; `picked` takes the (x, y) of a clicked point."""

    def __init__(self, board: Board, picked: Callable[[int, int], None]) -> None:
        import viser

        self._board, self._picked = board, picked
        self._wake = threading.Condition()
        self._stale: set[str] = set()
        self._closed = False
        self._scene, self._shown = Scene(), Scene()
        self._serial: object = None
        self._cloud: Cloud | None = None
        self._cloud_at = 0.0
        self._centres: NDArray[np.float64] | None = None
        self._is_marked = True  # not while pictures are saved
        self._orbits: dict[int, tuple[float, Pose]] = {}  # of each browser: since when, and from where
        self.token = secrets.token_urlsafe(24)
        with _guarded(self.token), _silent():
            self._server = viser.ViserServer(host=HOST, port=0, verbose=False)
        self._server.request_share_url = _refuse_to_share  # type: ignore[method-assign]  # pages can ask for it
        self._server.scene.set_up_direction("-y")
        self._server.scene.configure_environment_map(None)
        self._server.scene.configure_default_lights(False)
        self._server.scene.add_light_ambient("/light", intensity=math.pi)  # the colour of a surface is what is seen
        self._server.scene.on_click()(self._clicked)
        self._server.on_client_connect(self._place)
        threading.Thread(target=self._draw_forever, name="lfgpu-space", daemon=True).start()

    @property
    def port(self) -> int:
        """The port of 127.0.0.1 at which viser answers those who know the token."""
        return self._server.get_port()

    def show(self, scene: Scene) -> None:
        """Show something else."""
        with self._wake:
            self._scene = scene
            self._ask("scene")

    def refresh(self) -> None:
        """Draw again if what is shown has changed."""
        self._ask("scene")

    def start_over(self) -> None:
        """Put the eye back to where it began."""
        self._ask("eye")

    def saved(self, form: str) -> tuple[bytes, str]:
        """Render what the frame shows, without marks, as a file; returns it with the end of its name.

        A "picture" has a scale, "mp4" and "gif" are films of an orbit.
        """
        from viser.transforms import SO3

        clients = list(self._server.get_clients().values())
        if not clients:
            raise LightFieldError("there is no picture of the points in space yet: open the tab 3D.")
        client, pose = clients[-1], Pose.of(clients[-1].camera)
        height, width = client.camera.image_height or 900, client.camera.image_width or 1200
        if form not in _SIDES:
            raise LightFieldError(f"what is seen in space is saved as {', '.join(_SIDES)}, not as {form!r}.")
        factor = min(1.0, _SIDES[form] / max(height, width))
        height, width = (max(1, round(factor * side)) for side in (height, width))

        drawn = count(1)

        def rendered(one: Pose) -> NDArray[np.uint8]:
            where = {"position": one.eye, "wxyz": SO3.from_matrix(one.axes).wxyz, "fov": one.fov}
            return client.get_render(height=height, width=width, transport_format="png", timeout=30.0, **where)

        def seen(one: Pose) -> NDArray[np.uint8]:
            say(f"picture {next(drawn)}{'' if form == 'picture' else f' of {PICTURES}'}")
            found = rendered(one)
            alpha = found[..., 3:].astype(np.float32) / 255
            behind = np.array(_PAGES.get(self._scene.background, _PAGES["white"]), np.float32)
            return (found[..., :3] * alpha + behind * (1 - alpha) + 0.5).astype(np.uint8)

        self._mark(visible=False)
        try:
            with self._board.working("Drawing points in space") as say:
                rendered(pose)  # not used: in the first picture after a change, points may have the size before it
                if form == "picture":
                    return _with_scale(seen(pose), self._scene, self._board.contents), ".png"
                orbit = (pose.orbited(k / PICTURES) for k in range(PICTURES))
                film = (np.divide(seen(one), 255, dtype=np.float32) for one in orbit)
                return saving.written(lambda path: write_frames(film, path, fps=16), f".{form}"), f".{form}"
        except (TimeoutError, RuntimeError):
            raise LightFieldError("the browser did not draw the points in space; open the tab 3D.") from None
        finally:
            self._mark(visible=True)

    def close(self) -> None:
        """End the scene and free its port."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        with _silent():
            self._server.stop()

    # --- drawing ---

    def _ask(self, what: str) -> None:
        with self._wake:
            self._stale.add(what)
            self._wake.notify()

    def _draw_forever(self) -> None:
        late = False
        while True:
            with self._wake:
                pause = _ORBIT_STEP if self._scene.orbit else _LIVE_CLOUD if late else None
                self._wake.wait_for(lambda: self._closed or bool(self._stale), pause)
                if self._closed:
                    return
                stale, self._stale = self._stale, set()
                scene = self._scene
            try:
                if stale or late:
                    late = self._draw(scene, self._board.contents, stale)
                self._orbit(scene.orbit)
            except Exception:
                if not self._closed:  # a scene that is gone takes no more messages
                    logging.getLogger("lfgpu.viewer").exception("the points in space could not be drawn")

    def _draw(self, scene: Scene, contents: Contents, stale: set[str]) -> bool:
        """Draw what has changed; returns whether a cloud is still to be drawn."""
        shown, first = self._shown, self._cloud is None
        entry = contents.all_entries().get(scene.result)
        serial = (None if entry is None else entry.serial, id(contents.lf))
        apart = {name: getattr(shown, name) for name in ("x", "y", "x0", "y0", "aspect", "orbit", "background")}
        moved = replace(scene, **apart) != shown
        late = serial != self._serial and not moved and monotonic() - self._cloud_at < _LIVE_CLOUD
        if late:
            return True
        if serial != self._serial or moved or first:
            other_frame = (scene.metric, scene.cameras) != (shown.metric, shown.cameras)
            self._draw_cloud(scene, contents)
            self._draw_cameras(scene, contents)
            self._serial, self._cloud_at = serial, monotonic()
            if first or other_frame:
                stale = stale | {"eye"}
        self._shown = scene
        self._draw_mark(scene)
        if "eye" in stale:
            for client in self._server.get_clients().values():
                self._place(client)
        return False

    def _draw_cloud(self, scene: Scene, contents: Contents) -> None:
        entry, scenery = contents.all_entries().get(scene.result), self._server.scene
        if entry is None:
            for name in ("/cloud", "/surface", "/mark", "/span"):
                scenery.remove_by_name(name)
            self._cloud = None
            return
        values = replace(
            entry.map,
            disparity=entry.stage(scene.stage),
            position=contents.position,
            geometry=contents.geometry if scene.metric else None,
        )
        colours = _painted(scene, contents)
        options: dict[str, Any] = {"most_points": _MESH_POINTS} if scene.mesh else {}
        cloud = self._cloud = shown_cloud(values, colours, least_confidence=scene.least, **options)
        scenery.remove_by_name("/cloud" if scene.mesh else "/surface")
        if scene.mesh and len(cloud.points):
            mesh = surface_glb(cloud.points, surface(cloud, values.disparity), cloud.colours)
            scenery.add_glb("/surface", mesh, cast_shadow=False, receive_shadow=False)
        else:
            scenery.add_point_cloud(
                "/cloud",
                cloud.points,
                cloud.colours,
                point_size=float(cloud.spacing * scene.size),
                point_shape="square",
                point_shading="flat",
                precision="float32",
            )

    def _draw_cameras(self, scene: Scene, contents: Contents) -> None:
        """Draw the frustums of the cameras, their size a part of their distance; they need a geometry."""
        lf, geometry = contents.lf, contents.geometry
        if not (scene.cameras and scene.metric and lf is not None and geometry is not None):
            self._server.scene.remove_by_name("/cameras")
            self._centres = None
            return
        height, width = lf.size
        deep = 0.8 * geometry.baseline_m
        half = deep / geometry.focal_length_px * np.array([width / 2, height / 2 / geometry.pixel_aspect])
        half *= min(1.0, 0.45 * geometry.baseline_m / float(half.max()))
        corners = np.array([(*half * sign, deep) for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        lines = np.array(
            [(corners[k], corners[(k + 1) % 4]) for k in range(4)] + [(np.zeros(3), corner) for corner in corners]
        )
        centres = np.stack([geometry.camera((float(u), float(v))) for u, v in lf.positions])
        if geometry.unshifted_at is None:  # all maps are in the frame of their own camera
            centres[:, :2] = geometry.centres(lf.offsets)
        self._centres = centres
        segments = (centres[:, None, None] + lines).reshape(-1, 2, 3).astype(np.float32)
        shades = np.array([_CAMERAS[n == lf.reference_index] for n in range(len(centres))], np.uint8)
        colours = np.repeat(np.repeat(shades, len(lines), axis=0)[:, None], 2, axis=1)
        self._server.scene.add_line_segments("/cameras", segments, colours, thickness=1.5, thickness_units="screen")

    def _draw_mark(self, scene: Scene) -> None:
        cloud = self._cloud
        if cloud is None or not len(cloud.pixels):
            self._server.scene.remove_by_name("/mark")
            return
        pixels = np.array([(scene.x, scene.y), (scene.x0, scene.y0)])
        end, start = (cloud.points[int(np.abs(cloud.pixels - one).sum(axis=1).argmin())] for one in pixels)
        self._server.scene.add_icosphere(
            "/mark", radius=4 * cloud.spacing, color=SLOPE, position=end, visible=self._is_marked
        )
        if scene.x0 < 0:
            self._server.scene.remove_by_name("/span")
        else:
            line = np.stack([start, end])[None]
            self._server.scene.add_line_segments(
                "/span", line, SLOPE, thickness=3.0, thickness_units="screen", visible=self._is_marked
            )

    def _mark(self, *, visible: bool) -> None:
        self._is_marked = visible
        for name in ("/mark", "/span"):
            if (mark := self._server.scene.get_handle_by_name(name)) is not None:
                mark.visible = visible
        self._server.flush()

    def _place(self, client: Any) -> None:
        """Put the eye of a browser a little beside the reference camera, such that the cloud fills the frame."""
        cloud = self._cloud
        if cloud is None or not len(cloud.points):
            return
        eye, target, fov = framed(cloud, self._scene.aspect, self._centres)
        camera, away = client.camera, float(np.linalg.norm(target - eye))
        camera.up_direction = (0.0, -1.0, 0.0)
        camera.position, camera.look_at, camera.fov = eye, target, fov
        camera.near, camera.far = away / 1000, away * 100

    def _orbit(self, wanted: bool) -> None:
        """Let the eyes go on along their orbits; at the end they are back where each began."""
        if not (wanted or self._orbits):
            return
        for number, client in self._server.get_clients().items():
            begin, pose = self._orbits.setdefault(number, (monotonic(), Pose.of(client.camera)))
            now = pose.orbited((monotonic() - begin) / _ORBIT if wanted else 0)
            client.camera.position, client.camera.look_at = now.eye, now.target
        if not wanted:
            self._orbits.clear()

    def _clicked(self, event: Any) -> None:
        if self._cloud is not None and (pixel := nearest_to_ray(self._cloud, event.ray_origin, event.ray_direction)):
            self._picked(*pixel)


def framed(
    cloud: Cloud, aspect: float, cameras: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return a camera that sees a cloud and cameras [n, 3]: its place, its target, its vertical field of view."""
    deep = cloud.points[:, 2].astype(np.float64) - float(cloud.eye[2])
    away = min(float(np.median(deep)), _NEAR * float(np.quantile(deep, 0.01)))  # what is near stays before the eye
    if cameras is None:
        eye = cloud.eye + away * np.array(_BESIDE)
    else:
        eye = cloud.eye + away * np.array(_BEHIND)
        eye[2] = min(eye[2], cameras[:, 2].min() - float(np.ptp(cameras, axis=0).max()))
    points = cloud.points[:: max(1, len(cloud.points) // 5000)].astype(np.float64)
    if cameras is not None:
        points = np.concatenate([points, np.repeat(cameras, -(-len(points) // (20 * len(cameras))), axis=0)])
    for _ in range(_STEPS_BACK):
        target, forward, sides = _aimed(eye, cloud.centre, points)
        reach = 1.1 * max(sides[1], sides[0] / max(aspect, 0.1))
        if reach <= _WIDEST:
            break
        eye = eye - 0.5 * np.linalg.norm(target - eye) * forward
    return eye, target, float(np.clip(2 * math.atan(reach), 0.05, 2.2))


def _aimed(
    eye: NDArray[np.float64], target: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float]]:
    """Aim an eye at the middle of points: what it looks at, in which direction, and how far they reach right and down.

    The reach is in tangents of angles, without a few of the outermost points.
    """
    for _ in range(8):  # the middle of the picture is not that of the cloud
        right, down, forward = Pose(eye, target).axes.T
        relative = points - eye
        deep = np.maximum(relative @ forward, 1e-6 * np.linalg.norm(target - eye))
        sides = np.stack([relative @ right, relative @ down]) / deep
        low, high = np.quantile(sides, (0.002, 0.998), axis=1)
        middle = np.tan((np.arctan(low) + np.arctan(high)) / 2)  # of the angles: a wide cloud stays before the eye
        target = eye + (forward + middle[0] * right + middle[1] * down) * np.linalg.norm(target - eye)
    return target, forward, (float(high[0] - low[0]) / 2, float(high[1] - low[1]) / 2)


def _with_scale(drawn: NDArray[np.uint8], scene: Scene, contents: Contents) -> bytes:
    """Encode a picture of points as PNG, with the scale of their colours if these are those of a map."""
    if scene.paint not in QUANTITIES or not scene.low < scene.high:
        return encoded(drawn)
    limits = scene.low, scene.high
    return encoded(
        beside_scale(
            drawn,
            label=LOOKS[scene.paint].title,
            colours=scene.colours,
            limits=limits,
            extent=contents.extent(scene.paint) or limits,
            paper=_PAGES.get(scene.background, _PAGES["white"]),
        )
    )


def _painted(scene: Scene, contents: Contents) -> NDArray[np.uint8]:
    """Return the colours of the points: the view, or a map."""
    lf = contents.lf
    if scene.paint == "picture" and lf is not None:
        picture = np.minimum(
            lf.image(lf.reference_index) * np.float32(2.0 ** np.clip(scene.exposure, -_EXPOSURE, _EXPOSURE)), 1
        )
        return rgb(picture ** np.float32(1 / max(scene.gamma, 0.01)), 1.0)
    kind = scene.paint if scene.paint in QUANTITIES else "disparity"
    values = contents.map(scene.result, kind, scene.stage)
    if values is None:
        assert contents.size is not None
        values = np.full(contents.size, np.nan, np.float32)
    return painted(values, scene.colours, (scene.low, scene.high))


def _refuse_to_share(*_: object, **__: object) -> None:
    """Prevent viser from opening a public tunnel through a server of its makers."""


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress the messages of viser on the terminal."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


@contextmanager
def _guarded(token: str) -> Iterator[None]:
    """Have servers that start meanwhile answer nobody who does not know the token, the first part of the path."""
    import websockets.asyncio.server as place

    _starting.acquire()
    serve = place.serve

    def guarded(handler: Any, *arguments: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            first, _, rest = request.path.removeprefix("/").partition("/")
            if not secrets.compare_digest(first.partition("?")[0].encode(), token.encode()):
                return connection.respond(HTTPStatus.FORBIDDEN, "This is a part of lfgpu view.\n")
            return process_request(connection, replace(request, path=f"/{rest}"))

        return serve(handler, *arguments, process_request=answer, origins=[None], logger=_UNHEARD, **options)

    place.serve = guarded  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        place.serve = serve  # type: ignore[misc]
        _starting.release()

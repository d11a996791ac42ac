"""The session of one browser tab: its controls, and a thread that draws."""

from __future__ import annotations

import logging
import math
import os
import threading
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from lfgpu.config import Config, parameters
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.methods import PRESETS, preset
from lfgpu.metrics import evaluate
from lfgpu.printable import message
from lfgpu.viewer.cloud import Cloud, nearest_to_ray, shown_cloud
from lfgpu.viewer.contents import FINAL, TRUTH, Contents
from lfgpu.viewer.markdown import plain
from lfgpu.viewer.solving import Progress, Request, Solver
from lfgpu.viz import panels as frames
from lfgpu.viz.refocusing import all_in_focus, refocus

if TYPE_CHECKING:
    import viser


_NOTHING = "nothing"
_METRES, _DISPARITY = "metres", "disparity"
_PICTURE = "picture"
_QUALITY = 88  # of JPEG
_LEFT, _RIGHT = 560, 360  # pixels of the panels
_LIVE_CLOUD = 0.5  # seconds between two point clouds of a stream
_PREVIEW = 640  # pixels of the longer side of refocused pictures, about
_FOCUS_VIEWS = 49  # of a refocused picture, so that it follows its slider
_SHARP_VIEWS = 25  # of a picture that is sharp everywhere
_BILINEAR = 1
_EMPTY = "No map yet: make one with Estimate, at the right."
_UNIT = "px per view step, larger is nearer"
_FIRST_PARAMETER = "alignment.iterations"
_ROOM = (0.4, 0.75)  # width over height of what the panels leave of the window, about


class Board(Protocol):
    """What all tabs of a viewer share."""

    solver: Solver
    """The solver of the page."""

    @property
    def contents(self) -> Contents:
        """What is shown now."""
        ...

    def open_from_page(self, path: str | os.PathLike[str]) -> None:
        """Show what a path holds, if pages may open it."""


class Session:
    """The session of one tab. Handlers only mark what has to be redrawn; a thread draws the newest state.

    Parameters
    ----------
    viewer
        What the tabs have in common.
    client
        The tab.
    """

    def __init__(self, viewer: Board, client: viser.ClientHandle) -> None:
        self._viewer, self._client = viewer, client
        self._wake = threading.Condition()
        self._stale: set[str] = {"rebuild"}
        self._closed = False
        self._handles: list[Any] = []
        self._built: Contents | None = None
        self._wanted: str | None = None
        self._cloud: Cloud | None = None
        self._cloud_at, self._cloud_is_late = 0.0, False
        self._is_live = False
        self._settings: dict[str, str] = {}
        self._drawn: dict[str, frames.Picture] = {}
        client.scene.on_click()(self._clicked)

    def start(self) -> None:
        """Start the thread that draws."""
        threading.Thread(target=self._draw_forever, name="lfgpu-tab", daemon=True).start()

    # --- what others tell it ---

    def new_contents(self, newest: str | None = None, *, live: bool = False, views: bool = False) -> None:
        """Update after the maps or the views changed, with the same size; selects the map `newest`."""
        with self._wake:
            self._is_live = live
            if newest is not None:
                self._wanted = newest
            stale = {"map", "cloud", "facts"} | ({"choices"} if not live or newest is not None else set())
            self._ask(*stale, *(("views", "focus") if views or not live else ()))

    def rebuild(self) -> None:
        """Rebuild everything, sizes and controls included."""
        self._ask("rebuild")

    def show_progress(self, progress: Progress) -> None:
        """Show the progress of an estimate."""
        if self._built is not None and not self._closed:
            _assign(self._progress, progress.share)
            self._progress.animated = progress.busy
            self._state.content = f"**{plain(progress.text)}**" if progress.failed else plain(progress.text)
            self._run.disabled, self._stop.disabled = progress.busy, not progress.busy

    def close(self) -> None:
        """Stop drawing."""
        with self._wake:
            self._closed = True
            self._wake.notify()

    # --- drawing ---

    def _ask(self, *what: str) -> None:
        with self._wake:
            self._stale.update(what)
            self._wake.notify()

    def _draw_forever(self) -> None:
        while True:
            with self._wake:
                woken = self._wake.wait_for(
                    lambda: self._closed or bool(self._stale), _LIVE_CLOUD if self._cloud_is_late else None
                )
                if self._closed:
                    return
                stale, self._stale = self._stale if woken else {"cloud"}, set()
            try:
                self._draw(stale)
            except LfgpuError as error:
                self._tell(str(error))
            except Exception:
                if self._closed:  # a tab that is gone takes no more messages
                    return
                logging.getLogger("lfgpu.viewer").exception("a picture could not be drawn")

    def _draw(self, stale: set[str]) -> None:
        contents = self._viewer.contents
        if "rebuild" in stale:
            self._build(contents)
            stale = {"choices", "views", "map", "cloud", "focus", "facts", "camera"}
        if self._built is None or contents.size is None:
            return
        if "choices" in stale:
            self._choose(contents)
        if "views" in stale:
            self._draw_views(contents)
        if "map" in stale:
            self._draw_map(contents)
        if "facts" in stale:
            self._facts.content = self._describe(contents)
        if "cloud" in stale:
            self._draw_cloud(contents)
        if "camera" in stale:
            self._place_camera()
        if "cursor" in stale or "cloud" in stale:
            self._draw_cursor()
        if "focus" in stale:
            self._draw_focus(contents)

    def _draw_views(self, contents: Contents) -> None:
        lf = contents.lf
        if lf is None:
            return
        index = self._view_index(lf)
        entry = contents.all_entries().get(self._result.value)
        x, y = self._cursor()
        disparity = None if entry is None else float(entry.stage(self._stage.value)[y, x])
        picture = frames.view_with_epis(lf, index, x, y, disparity)
        self._drawn["views"] = picture
        self._views.image = frames.centred(picture)
        u, v = lf.positions[index]
        du, dv = lf.offsets[index]
        what = "the reference" if index == lf.reference_index else f"du {du:g}, dv {dv:g} from the reference"
        self._where.content = plain(f"View at row {v:g}, column {u:g}: {what}. {self._at_cursor(contents, x, y)}")

    def _at_cursor(self, contents: Contents, x: int, y: int) -> str:
        name, said = self._result.value, []
        for kind, unit in (("disparity", " px per view step"), ("depth", " m"), ("confidence", ""), ("error", " px")):
            values = contents.map(name, kind, self._stage.value)
            if values is not None and not (kind == "error" and name == TRUTH):
                value = float(values[y, x])
                said.append(f"{kind} {f'{value:.3f}{unit}' if math.isfinite(value) else 'undefined'}")
        return f"At ({x}, {y}): {', '.join(said)}." if said else ""

    def _draw_map(self, contents: Contents) -> None:
        kind, stage = self._kind.value, self._stage.value
        if not contents.all_entries():
            self._map.image = frames.notice(_EMPTY)
            return
        first = contents.map(self._result.value, kind, stage)
        if first is None:
            size = contents.size
            assert size is not None
            first, name = np.full(size, np.nan, np.float32), f"no {kind} of {self._result.value}"
        else:
            name = self._result.value if stage == FINAL else f"{self._result.value}, {stage}"
        other, second = self._other.value, None
        if other != _NOTHING:
            values = contents.map(other, kind)
            second = None if values is None else frames.Shown(values, other)
        picture = self._drawn["map"] = frames.map_picture(
            frames.Shown(first, name),
            kind,
            contents.limits(kind),
            second=second,
            wipe=self._wipe.value / 100,
            cursor=self._cursor(),
        )
        self._map.image = frames.centred(picture)

    def _draw_focus(self, contents: Contents) -> None:
        lf = contents.lf
        if lf is None:
            return
        step = max(1, round(max(lf.size) / _PREVIEW))
        if self._everywhere.value:
            entry = contents.all_entries().get(self._result.value)
            if entry is None:
                raise LightFieldError("a picture that is sharp everywhere needs a map; press Estimate.")
            values = DisparityMap(entry.stage(self._stage.value))
            picture = all_in_focus(lf, values, step=step, most_views=_SHARP_VIEWS, order=_BILINEAR)
        else:
            picture = refocus(lf, self._focus.value, step=step, most_views=_FOCUS_VIEWS, order=_BILINEAR)
        image = frames.fitted(frames.rgb(picture, 1.0), wide=900, tall=600)
        self._drawn["refocused"] = np.asarray(image)
        self._focused.image = frames.centred(np.asarray(image))

    def _draw_cloud(self, contents: Contents) -> None:
        entry = contents.all_entries().get(self._result.value)
        if entry is None:
            if self._cloud is not None:
                self._client.scene.remove_by_name("/cloud")
                self._cloud = None
            return
        self._cloud_is_late = self._is_live and monotonic() - self._cloud_at < _LIVE_CLOUD
        if self._cloud_is_late:
            return
        self._cloud_at = monotonic()
        values = replace(
            entry.map,
            disparity=entry.stage(self._stage.value),
            position=contents.position,
            geometry=contents.geometry if self._units.value == _METRES else None,
        )
        cloud = shown_cloud(values, self._colours(contents), least_confidence=self._least.value)
        first, self._cloud = self._cloud is None, cloud
        self._client.scene.add_point_cloud(
            "/cloud",
            cloud.points,
            cloud.colours,
            point_size=float(cloud.spacing * self._thick.value),
            point_shape="square",
            point_shading="flat",
            precision="float32",
        )
        if first:
            self._place_camera()

    def _colours(self, contents: Contents) -> frames.Picture:
        """The colours of the points: the view, or a map if there are no views."""
        kind = self._paint.value
        if kind == _PICTURE and contents.lf is not None:
            return frames.rgb(contents.lf.views[contents.lf.reference_index], contents.lf.scale)
        kind = "disparity" if kind == _PICTURE else kind
        values = contents.map(self._result.value, kind, self._stage.value)
        if values is None:
            assert contents.size is not None
            values = np.full(contents.size, np.nan, np.float32)
        return frames.colour(values, frames.LOOKS[kind].colours, contents.limits(kind))

    def _place_camera(self) -> None:
        """The initial eye: the reference camera, moved a little to the side to make depth visible."""
        if self._cloud is None or not len(self._cloud.points):
            return
        camera, centre, eye = self._client.camera, self._cloud.centre, self._cloud.eye
        away, aspect = float(centre[2]), float(np.clip(camera.aspect, *_ROOM))
        width, height = np.ptp(self._cloud.points[:, :2], axis=0) / away
        reach = 1.35 * max(float(height), float(width) / aspect)
        camera.up_direction = (0.0, -1.0, 0.0)
        camera.position = (float(eye[0]) + 0.22 * away, float(eye[1]) - 0.14 * away, 0.02 * away)
        camera.look_at = (float(centre[0]), float(centre[1]), away)
        camera.fov = float(np.clip(2 * math.atan(reach / 2), 0.1, 2.0))
        camera.near, camera.far = away / 1000, away * 100

    def _draw_cursor(self) -> None:
        if self._cloud is None or not len(self._cloud.pixels):
            return
        there = np.abs(self._cloud.pixels - self._cursor()).sum(axis=1)
        place = self._cloud.points[int(np.argmin(there))]
        self._client.scene.add_icosphere(
            "/cursor",
            radius=4 * self._cloud.spacing,
            color=frames.SLOPE,
            position=place.astype(np.float64),
            cast_shadow=False,
            receive_shadow=False,
        )

    # --- the page ---

    def _build(self, contents: Contents) -> None:
        for handle in self._handles:
            handle.remove()
        self._handles, self._cloud = [], None
        self._client.scene.reset()
        gui, lf = self._client.gui, contents.lf
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Look"):
            self._build_choices(contents)
            self._build_cursor(contents)
            self._build_points(contents)
        with tabs.add_tab("Estimate"):
            self._build_estimation(lf)
        with tabs.add_tab("Files"):
            self._path = gui.add_text("Path", "", hint="A light field, or what lfgpu depth wrote")
            gui.add_button("Open").on_click(self._open)
            gui.add_markdown("A light field replaces all that is shown, in all tabs; a map of it joins the others.")
            gui.add_button_group("Save", ("map", "views", "refocused", "3D")).on_click(self._save)
        maps = self._build_pictures(contents)
        self._handles += [tabs, *maps]
        self._built = contents
        self.show_progress(self._viewer.solver.progress)

    def _build_pictures(self, contents: Contents) -> list[Any]:
        """The panels at the left, one below the other."""
        gui, panels = self._client.gui, []
        if contents.lf is not None:
            panel = gui.add_panel()
            with panel.add_tab("Views and EPIs"):
                self._views = self._image("")
                self._where = gui.add_markdown("")
            with panel.add_tab("Refocus"):
                low, high = self._focus_range(contents)
                self._focus = self._on(
                    gui.add_slider("Focus", low, high, 0.01, 0.0 if low <= 0 <= high else low, hint=_UNIT), "focus"
                )
                self._everywhere = self._on(
                    gui.add_checkbox("Sharp everywhere", False, hint="Each pixel focused on its disparity"), "focus"
                )
                self._focused = self._image("")
            panel.dock_left()
            panel.set_width(_LEFT)
            panels.append(panel)
        panel = gui.add_panel()
        with panel.add_tab("Map"):
            self._map = self._image(_EMPTY)
        if panels:
            panel.dock_below(panels[0])
        else:
            panel.dock_left()
            panel.set_width(_LEFT)
        return [*panels, panel]

    def _build_choices(self, contents: Contents) -> None:
        gui = self._client.gui
        with gui.add_folder(contents.lf.name if contents.lf is not None else "Maps"):
            self._kind = self._on(gui.add_dropdown("Show", self._kinds(contents)), "map")
            self._result = self._on(gui.add_dropdown("Of", (_NOTHING,)), "choices", "map", "cloud", "views", "facts")
            self._stage = self._on(gui.add_dropdown("After", (FINAL,)), "map", "cloud", "views", "facts")
            self._other = self._on(gui.add_dropdown("Beside", (_NOTHING,), hint="Compare with another map"), "map")
            self._wipe = self._on(gui.add_slider("Wipe", 0, 100, 1, 50, hint="Share of the first of the two"), "map")
            gui.add_button("Swap the two", color="gray").on_click(lambda _: self._swap())
            self._facts = gui.add_markdown(_EMPTY)

    def _build_cursor(self, contents: Contents) -> None:
        gui, lf, (height, width) = self._client.gui, contents.lf, contents.size or (1, 1)
        with gui.add_folder("View and pixel" if lf is not None else "Pixel"):
            self._place = []
            if lf is not None and lf.grid_shape is not None:
                u, v = lf.positions[lf.reference_index]
                for label, count, at in zip(("View row", "View column"), lf.grid_shape, (v, u), strict=True):
                    if count > 1:
                        slider = gui.add_slider(label, 0, count - 1, 1, round(float(at)))
                        self._place.append(self._on(slider, "views"))
            elif lf is not None:
                slider = gui.add_slider("View", 0, len(lf.views) - 1, 1, lf.reference_index)
                self._place.append(self._on(slider, "views"))
            self._x = self._on(gui.add_slider("x", 0, width - 1, 1, width // 2), "views", "map", "cursor")
            self._y = self._on(gui.add_slider("y", 0, height - 1, 1, height // 2), "views", "map", "cursor")

    def _build_points(self, contents: Contents) -> None:
        gui = self._client.gui
        with gui.add_folder("Points in space"):
            units = (_METRES, _DISPARITY) if contents.geometry is not None else (_DISPARITY,)
            self._units = self._on(gui.add_dropdown("Unit", units), "cloud", "camera")
            kinds = self._kinds(contents)
            self._paint = self._on(
                gui.add_dropdown("Colour", (_PICTURE, *kinds) if contents.lf is not None else kinds), "cloud"
            )
            self._least = self._on(gui.add_slider("Surer than", 0.0, 1.0, 0.01, 0.0, hint="Confidence"), "cloud")
            self._thick = self._on(gui.add_slider("Size", 0.5, 4.0, 0.1, 1.3), "cloud")
            gui.add_button("Back to the camera", color="gray").on_click(lambda _: self._ask("camera"))

    def _build_estimation(self, lf: LightField | None) -> None:
        gui = self._client.gui
        if lf is None:
            gui.add_markdown("A map alone cannot be estimated again: open the light field that it is of.")
        self._preset = gui.add_dropdown("Preset", tuple(PRESETS), visible=lf is not None)
        self._preset.on_update(lambda _: self._show_parameter())
        with gui.add_folder("Disparity range", visible=lf is not None):
            self._found = gui.add_checkbox("Find it", True)
            self._low = gui.add_number("From", -2.0, step=0.1, disabled=True, hint=_UNIT)
            self._high = gui.add_number("To", 2.0, step=0.1, disabled=True, hint=_UNIT)
            self._found.on_update(lambda _: self._toggle_range())
        with gui.add_folder("Parameters", visible=lf is not None):
            names = tuple(name for name, _ in parameters(self._config()))
            self._parameter = gui.add_dropdown("Parameter", names, initial_value=_FIRST_PARAMETER)
            self._parameter.on_update(lambda _: self._show_parameter())
            self._value = gui.add_text("Value", "")
            self._meaning = gui.add_markdown("")
            gui.add_button("Change it", color="gray").on_click(self._set)
            gui.add_button("Take back all changes", color="gray").on_click(self._unset)
        self._run = gui.add_button("Estimate", visible=lf is not None)
        self._run.on_click(self._estimate)
        self._stop = gui.add_button("Stop", disabled=True, color="gray", visible=lf is not None)
        self._stop.on_click(lambda _: self._viewer.solver.stop())
        self._progress = gui.add_progress_bar(0.0, visible=lf is not None)
        self._state = gui.add_markdown("")
        self._show_parameter()

    def _image(self, text: str) -> Any:
        return self._client.gui.add_image(frames.notice(text), format="jpeg", jpeg_quality=_QUALITY)

    def _on(self, handle: Any, *what: str) -> Any:
        """Register a control whose changes redraw something."""
        handle.on_update(lambda _: self._ask(*what))
        return handle

    def _kinds(self, contents: Contents) -> tuple[str, ...]:
        without = {
            "depth": contents.geometry is None,
            "error": contents.truth is None,
        }
        return tuple(kind for kind in frames.LOOKS if not without.get(kind, False))

    def _choose(self, contents: Contents) -> None:
        """Update the lists of maps."""
        names = tuple(contents.all_entries())
        wanted, self._wanted = self._wanted, None
        before = self._result.value
        if names:
            chosen = wanted if wanted in names else before if before in names else names[-1]
            if wanted is None and before == _NOTHING:
                chosen = next((name for name in names if name != TRUTH), names[0])
            _set_options(self._result, names, chosen)
        else:
            _set_options(self._result, (_NOTHING,), _NOTHING)
        if wanted in names and before in names and before != wanted and self._other.value == _NOTHING:
            _set_options(self._other, (_NOTHING, *names), before)
        else:
            other = self._other.value if self._other.value in names else _NOTHING
            _set_options(self._other, (_NOTHING, *names), other)
        entry = contents.all_entries().get(self._result.value)
        stages = () if entry is None or entry.result is None else tuple(entry.result.disparity_stages)[:-1]
        stage = self._stage.value if self._stage.value in stages else FINAL
        _set_options(self._stage, (FINAL, *stages), stage)

    def _swap(self) -> None:
        first, second = self._result.value, self._other.value
        if second != _NOTHING and first != _NOTHING:
            self._result.value, self._other.value = second, first

    def _describe(self, contents: Contents) -> str:
        entries = contents.entries
        if not entries:
            return _EMPTY
        entry, lines = contents.all_entries().get(self._result.value), []
        if entry is not None and entry.result is not None:
            result = entry.result
            lines.append(
                plain(
                    f"{result.config.method} with {result.backend} on {result.device}, "
                    f"{result.timings.get('total', math.nan):.2f} s. {result.status}"
                )
            )
        truth = contents.truth
        if truth is not None:
            rows = []
            for name, one in entries.items():
                try:
                    m = evaluate(one.disparity, truth)
                except LightFieldError:
                    continue
                rows.append(
                    f"| {plain(name)} | {m.mse_100:.2f} | {m.badpix_07:.2f} | {m.badpix_01:.1f} | {m.q25:.2f} |"
                )
            if rows:
                lines.append(
                    "\n".join(["| | MSE×100 | Bad 0.07 % | Bad 0.01 % | Q25 |", "|---|---:|---:|---:|---:|", *rows])
                )
        return "\n\n".join(lines)

    # --- what people do ---

    def _cursor(self) -> tuple[int, int]:
        return int(self._x.value), int(self._y.value)

    def _clicked(self, event: Any) -> None:
        """Select the pixel of a clicked point of the cloud."""
        if self._cloud is not None and (pixel := nearest_to_ray(self._cloud, event.ray_origin, event.ray_direction)):
            self._x.value, self._y.value = pixel

    def _view_index(self, lf: LightField) -> int:
        """The view at the position of the sliders, or the nearest one."""
        if lf.grid_shape is None:
            return int(self._place[0].value)
        places = iter(self._place)
        row, column = (next(places).value if count > 1 else 0 for count in lf.grid_shape)
        return int(np.argmin(np.abs(lf.positions - (column, row)).sum(axis=1)))

    def _focus_range(self, contents: Contents) -> tuple[float, float]:
        if contents.all_entries():
            low, high = contents.limits("disparity")
            margin = 0.2 * (high - low)
            return round(low - margin, 2), round(high + margin, 2)
        return -3.0, 3.0

    def _toggle_range(self) -> None:
        self._low.disabled = self._high.disabled = self._found.value

    def _config(self) -> Config:
        return preset(self._preset.value).with_values(self._settings)

    def _show_parameter(self) -> None:
        known = dict(parameters(preset(self._preset.value)))
        self._settings = {key: value for key, value in self._settings.items() if key in known}
        first = _FIRST_PARAMETER if _FIRST_PARAMETER in known else next(iter(known))
        name = self._parameter.value if self._parameter.value in known else first
        _set_options(self._parameter, tuple(known), name)
        meta = known[name].metadata
        stage, parameter = name.split(".")
        _assign(self._value, str(getattr(getattr(self._config(), stage), parameter)))
        extent = ", ".join(meta["choices"]) if "choices" in meta else f"{meta['low']:g} to {meta['high']:g}"
        changed = ", ".join(f"{key} = {value}" for key, value in self._settings.items())
        self._meaning.content = plain(f"{meta['doc']}; {extent}.")
        if changed:
            self._meaning.content += f"\n\n{plain(f'Changed: {changed}.')}"

    def _set(self, _: Any) -> None:
        settings = {**self._settings, self._parameter.value: self._value.value.strip()}
        try:
            preset(self._preset.value).with_values(settings)
        except LfgpuError as error:
            self._tell(str(error))
            return
        self._settings = settings
        self._show_parameter()

    def _unset(self, _: Any) -> None:
        self._settings = {}
        self._show_parameter()

    def _estimate(self, _: Any) -> None:
        lf = self._viewer.contents.lf
        if lf is None:
            return
        bounds = None if self._found.value else (float(self._low.value), float(self._high.value))
        name = self._preset.value + "".join(f", {key.split('.')[1]} {value}" for key, value in self._settings.items())
        try:
            request = Request(lf, self._config(), bounds, name)
        except LfgpuError as error:
            self._tell(str(error))
            return
        if not self._viewer.solver.start(request):
            self._tell("An estimate is being made already; wait for it, or press Stop.")

    def _open(self, _: Any) -> None:
        text = self._path.value.strip()
        if not text:
            self._tell("Type the path of a light field, or of what lfgpu depth wrote.")
            return
        try:
            self._viewer.open_from_page(Path(text).expanduser())
        except (LfgpuError, OSError) as error:
            self._tell(str(error))

    def _save(self, event: Any) -> None:
        what = event.target.value
        if what == "3D":
            camera = self._client.camera
            picture = self._client.get_render(
                height=camera.image_height or 900, width=camera.image_width or 1200, transport_format="png"
            )[..., :3]
        elif what in self._drawn:
            picture = self._drawn[what]
        else:
            self._tell(f"There is no picture of this kind yet: {what}.")
            return
        self._client.send_file_download(f"lfgpu-{what}.png", frames.encoded(picture), save_immediately=True)

    def _tell(self, text: str) -> None:
        """A message on the page, for as long as nobody closes it or for some seconds."""
        self._client.add_notification("lfgpu", message(text), color="red", auto_close_seconds=15.0)


def _set_options(handle: Any, options: tuple[str, ...], value: str) -> None:
    """Without a change of the value in between, which would be drawn."""
    if tuple(handle.options) != options:
        handle.options = options
    if handle.value != value:
        handle.value = value


def _assign(handle: Any, value: object) -> None:
    """Set an attribute that viser's types wrongly declare read-only."""
    handle.value = value

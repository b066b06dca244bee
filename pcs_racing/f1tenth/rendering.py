"""The renderers that callbacks draw with: in a window where there can be one, or into a frame when it is asked for."""

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.f1tenth.maps import GymMap
from pcs_racing.f1tenth.old_names import get_vertices
from pcs_racing.race.painting import FINER, Camera, paint_car, theme_colours
from pcs_racing.race.rendering import Window

PIXELS = 50.0  # to the metre, of what callbacks of generation A draw
HALF_SIZE = np.array([0.5 * F1TENTH.length, 0.5 * F1TENTH.width])

Frame = NDArray[np.uint8]
Colour = tuple[int, ...]


def has_display() -> bool:
    """Whether a window can be opened."""
    try:
        import pygame  # noqa: F401
    except ImportError:
        return False
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    )


class _Painter:
    """The ground and the cars."""

    def __init__(self, loaded: GymMap, width: int, height: int, window: bool, fps: float) -> None:
        self.width, self.height = width, height
        self._colours, self._font = theme_colours("light"), ImageFont.load_default(16)
        self._window = Window(width, height, fps) if window and has_display() else None
        self.show_map(loaded)

    def show_map(self, loaded: GymMap) -> None:
        """Draw another map from now on."""
        self._map = loaded
        self._picture = Image.fromarray(np.where(loaded.free[::-1], np.uint8(255), np.uint8(110)))

    def _ground(self, camera: Camera) -> Image.Image:
        half = np.array([camera.width, camera.height]) / camera.scale * 0.5
        low = (np.array([camera.x, camera.y]) - half - self._map.origin) / self._map.resolution
        high = low + 2.0 * half / self._map.resolution
        rows = self._picture.height
        box = (low[0], rows - high[1], high[0], rows - low[1])
        size = (camera.width, camera.height)
        return self._picture.transform(size, Image.Transform.EXTENT, box, fillcolor=255).convert("RGB")

    def _cars(self, pen: ImageDraw.ImageDraw, camera: Camera, states: NDArray[np.float64]) -> None:
        for i, state in enumerate(states):
            paint_car(pen, camera, self._colours[f"car{min(i, 1)}"], self._colours["tyre"], state, HALF_SIZE)

    def _finish(self, image: Image.Image, text: str) -> Frame:
        small = image.reduce(FINER)
        ImageDraw.Draw(small).text((14, 10), text, fill=self._colours["ink"], font=self._font)
        return np.array(small)

    def _present(self, frame: Frame) -> None:
        try:
            assert self._window is not None
            self._window.show(frame)
        except RuntimeError:  # a display that is named but not there
            self._window = None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


@dataclass
class RenderSpec:
    """Settings of a renderer of generation B."""

    window_size: int = 800  #: Pixels.
    focus_on: str | None = "agent_0"  #: The car that is followed; None shows the whole map.
    zoom_in_factor: float = 1.5


class TrackRenderer(_Painter):
    """What callbacks of generation B are given."""

    def __init__(self, loaded: GymMap, spec: RenderSpec, *, window: bool, fps: float) -> None:
        super().__init__(loaded, spec.window_size, spec.window_size, window, fps)
        self.render_spec, self._shown = spec, window
        self._pen: ImageDraw.ImageDraw | None = None

    def draw(
        self, states: NDArray[np.float64], collisions: ArrayLike, now: float, callbacks: list[Callable[[Any], None]]
    ) -> Frame | None:
        """Draw the cars and what the callbacks add; return the frame unless it is shown."""
        self.cars, self.sim_time = states, now
        if self._shown and self._window is None:
            for callback in callbacks:
                callback(self)
            return None
        size = self.width * FINER
        focus = self.render_spec.focus_on
        whole = np.array(self._picture.size) * self._map.resolution
        x, y = self._map.origin + 0.5 * whole
        scale = size / float(whole.max())
        if focus is not None:
            x, y = states[min(int(focus.rpartition("_")[2]), len(states) - 1), :2]
            scale = FINER * self.render_spec.zoom_in_factor / self._map.resolution
        self._camera = Camera(float(x), float(y), scale, size, size)
        image = self._ground(self._camera)
        self._pen = ImageDraw.Draw(image, "RGBA")
        self._cars(self._pen, self._camera, states)
        for callback in callbacks:
            callback(self)
        self._pen = None
        frame = self._finish(image, f"{now:.2f} s")
        if self._window is None:
            return frame
        self._present(frame)
        return None

    def render_points(self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1) -> None:
        """Draw points, shape (N, 2), m."""
        if self._pen is not None:
            for x, y in self._camera.pixels(np.asarray(points, np.float64).reshape(-1, np.shape(points)[-1])):
                r = FINER * max(float(size), 1.0)
                self._pen.ellipse((x - r, y - r, x + r, y + r), fill=tuple(color))

    def render_lines(self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1) -> None:
        """Draw a line through points, shape (N, 2), m."""
        if self._pen is not None and len(np.asarray(points)) > 1:
            corners = self._camera.pixels(np.asarray(points, np.float64)).ravel().tolist()
            self._pen.line(corners, fill=tuple(color), width=FINER * max(int(size), 1))

    def render_closed_lines(self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1) -> None:
        """Draw a line through points and back to the first."""
        if len(np.asarray(points)):
            self.render_lines(np.vstack([points, np.asarray(points)[:1]]), color, size)


class VertexList:
    """Points of one drawing, ``vertices`` in pixels of :data:`PIXELS` to the metre; both lists may be replaced."""

    def __init__(self, batch: "Batch", count: int, mode: int, data: tuple[Any, ...]) -> None:
        self._batch, self.count, self.mode = batch, count, mode
        self.vertices: Any = []
        self.colors: Any = []
        self.width = 2
        for item in data:
            name, values = (item[0], item[1]) if isinstance(item, tuple | list) else (item, [0.0] * 3 * count)
            if name.startswith("v"):
                self.width, self.vertices = int(name[1]), list(values)
            elif name.startswith("c"):
                self.colors = list(values)

    def delete(self) -> None:
        """Draw it no more."""
        self._batch.lists.pop(self, None)


class Batch:
    """What callbacks of generation A add their drawings to."""

    def __init__(self) -> None:
        self.lists: dict[VertexList, None] = {}

    def add(self, count: int, mode: int, group: Any, *data: Any) -> VertexList:
        """Add points; ``data`` are ("v2f" or "v3f", numbers) and ("c3B", numbers)."""
        made = VertexList(self, count, mode, data)
        self.lists[made] = None
        return made

    def draw(self) -> None:
        """Nothing: the renderer draws."""


class Label:
    """A text; where it stands is not looked at."""

    def __init__(self, text: str = "", *args: Any, **named: Any) -> None:
        self.text, self.x, self.y = text, 0.0, 0.0
        self.__dict__.update(named)

    def draw(self) -> None:
        """Nothing: the renderer draws."""

    delete = draw


class EnvRenderer(_Painter):
    """What callbacks of generation A are given. ``left``, ``right``, ``top`` and ``bottom`` are what is shown."""

    def __init__(self, loaded: GymMap, *, window: bool, width: int = 1000, height: int = 800) -> None:
        super().__init__(loaded, width, height, window, 1000.0)
        self.left, self.right, self.bottom, self.top = -0.5 * width, 0.5 * width, -0.5 * height, 0.5 * height
        self.zoom_level, self.batch, self.score_label = 1.2, Batch(), Label()
        self.cars: list[VertexList] = []
        self.poses: Any = None

    def get_size(self) -> tuple[int, int]:
        """Return width and height in pixels."""
        return self.width, self.height

    def update_obs(self, obs: dict[str, Any], states: NDArray[np.float64]) -> None:
        """Take the cars' places."""
        self.ego_idx, self._states = obs["ego_idx"], states
        self.poses = np.stack((obs["poses_x"], obs["poses_y"], obs["poses_theta"]), axis=1)
        while len(self.cars) != len(self.poses):
            self.cars = [VertexList(self.batch, 4, 0, ()) for _ in self.poses]
        for car, pose in zip(self.cars, self.poses, strict=True):
            car.vertices = (PIXELS * get_vertices(pose, F1TENTH.length, F1TENTH.width)).ravel().tolist()
        count = obs["lap_counts"][self.ego_idx]
        self.score_label.text = f"Lap Time: {obs['lap_times'][0]:.2f}, Ego Lap Count: {count:.0f}"

    def draw(self, mode: str) -> Frame | None:
        """Show the frame, return it in mode "rgb_array", or leave it where nobody could see it."""
        if mode != "rgb_array" and self._window is None:
            return None
        across, high = max(self.right - self.left, 1.0) / PIXELS, max(self.top - self.bottom, 1.0) / PIXELS
        width, height = self.width * FINER, self.height * FINER
        x, y = 0.5 * (self.left + self.right) / PIXELS, 0.5 * (self.bottom + self.top) / PIXELS
        camera = Camera(x, y, min(width / across, height / high), width, height)
        image = self._ground(camera)
        pen = ImageDraw.Draw(image, "RGBA")
        for drawing in self.batch.lists:
            self._paint(pen, camera, drawing)
        self._cars(pen, camera, self._states)
        frame = self._finish(image, str(self.score_label.text))
        if mode == "rgb_array":
            return frame
        self._present(frame)
        if mode == "human":
            time.sleep(0.005)
        return None

    def _paint(self, pen: ImageDraw.ImageDraw, camera: Camera, drawing: VertexList) -> None:
        points = np.asarray(drawing.vertices, np.float64)
        points = camera.pixels(
            points[: points.size // drawing.width * drawing.width].reshape(-1, drawing.width) / PIXELS
        )
        colour = tuple(int(value) for value in list(drawing.colors)[:3]) or (183, 193, 222)
        flat = points.ravel().tolist()
        if drawing.mode == 0:  # points
            for px, py in points:
                pen.ellipse((px - FINER, py - FINER, px + FINER, py + FINER), fill=colour)
        elif drawing.mode in (2, 3) and len(points) > 1:  # a closed line, a line
            pen.line(flat + flat[:2] if drawing.mode == 2 else flat, fill=colour, width=FINER)
        elif drawing.mode == 1:  # pairs
            for k in range(0, len(flat) - 3, 4):
                pen.line(flat[k : k + 4], fill=colour, width=FINER)
        elif len(points) > 2:
            pen.polygon(flat, fill=colour)

"""Renderers for callbacks: in a window if one is available, or into a requested frame."""

import os
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from pcs_racing.base.compilation import compiled
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.f1tenth.maps import GymMap
from pcs_racing.race.painting import COLOURS, FINER, Camera, paint_car
from pcs_racing.race.rendering import Window

PIXELS = 50.0  # per metre, in drawings by callbacks of generation A
SIDE, ZOOM = 800, 1.5  # frames of generation B: pixels, and pixels per cell of the map
HALF_SIZE = np.array([0.5 * F1TENTH.length, 0.5 * F1TENTH.width])

Frame = NDArray[np.uint8]
Colour = tuple[int, ...]


@compiled
def get_vertices(pose, length, width):
    """Return the corners of a car at x, y, heading, shape (4, 2).

    The order is rear left, rear right, front right, front left.
    """
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    corners = np.empty((4, 2))
    for i in range(4):
        along = 0.5 * length if i >= 2 else -0.5 * length
        across = 0.5 * width if i % 3 == 0 else -0.5 * width
        corners[i, 0] = pose[0] + along * cosine - across * sine
        corners[i, 1] = pose[1] + along * sine + across * cosine
    return corners


def has_display() -> bool:
    """Return whether a window can be opened."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return find_spec("pygame") is not None and (named or not sys.platform.startswith("linux"))


class _Painter:
    """Painter of the ground and the cars, with a window if one is available."""

    def __init__(self, loaded: GymMap, width: int, height: int, window: bool, fps: float) -> None:
        self.width, self.height = width, height
        self._font = ImageFont.load_default(16)
        self._window = Window(width, height, fps) if window and has_display() else None
        self._pen: ImageDraw.ImageDraw | None = None  # only while a frame is drawn
        self.show_map(loaded)

    def show_map(self, loaded: GymMap) -> None:
        """Draw another map from now on."""
        self._map = loaded
        self._picture = Image.fromarray(np.where(loaded.free[::-1], np.uint8(255), np.uint8(110)))

    def _begin(self, x: float, y: float, scale: float) -> Image.Image:
        """Return the ground around a point (m), with ``scale`` fine pixels per metre."""
        camera = self._camera = Camera(x, y, scale, self.width * FINER, self.height * FINER)
        half = np.array([camera.width, camera.height]) / scale * 0.5
        low = (np.array([x, y]) - half - self._map.origin) / self._map.resolution
        high, rows = low + 2.0 * half / self._map.resolution, self._picture.height
        box = (low[0], rows - high[1], high[0], rows - low[1])
        size = (camera.width, camera.height)
        image = self._picture.transform(size, Image.Transform.EXTENT, box, fillcolor=255).convert(
            "RGB"
        )
        self._pen = ImageDraw.Draw(image, "RGBA")
        return image

    def _draw_cars(self, states: NDArray[np.float64]) -> None:
        assert self._pen is not None
        for i, state in enumerate(states):
            paint_car(self._pen, self._camera, COLOURS[f"car{min(i, 1)}"], state, HALF_SIZE)

    def _points(self, points: NDArray[np.float64], colour: Colour, radius: float) -> None:
        for x, y in self._camera.pixels(points) if self._pen is not None else ():
            self._pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=tuple(colour))  # type: ignore[union-attr]

    def _line(self, points: NDArray[np.float64], colour: Colour, width: int) -> None:
        if self._pen is not None and len(points) > 1:
            self._pen.line(
                self._camera.pixels(points).ravel().tolist(), fill=tuple(colour), width=width
            )

    def _end(self, image: Image.Image, text: str, show: bool) -> Frame | None:
        """Return the frame, or show it."""
        self._pen = None
        small = image.reduce(FINER)
        ImageDraw.Draw(small).text((14, 10), text, fill=COLOURS["ink"], font=self._font)
        frame = np.array(small)
        if not show or self._window is None:
            return frame
        try:
            self._window.show(frame)
        except RuntimeError:  # a named but missing display
            self._window = None
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


class TrackRenderer(_Painter):
    """Renderer for callbacks of generation B; it follows the first car."""

    def __init__(self, loaded: GymMap, *, window: bool, fps: float) -> None:
        super().__init__(loaded, SIDE, SIDE, window, fps)
        self._shown = window

    def draw(
        self, states: NDArray[np.float64], now: float, callbacks: list[Callable[[Any], None]]
    ) -> Frame | None:
        """Draw the cars and the drawings of callbacks; return the frame unless it is shown."""
        self.cars, self.sim_time = states, now
        visible = self._window is not None or not self._shown
        if visible:
            x, y = states[0, :2].tolist()
            image = self._begin(x, y, FINER * ZOOM / self._map.resolution)
            self._draw_cars(states)
        for callback in callbacks:
            callback(self)
        return self._end(image, f"{now:.2f} s", self._shown) if visible else None

    def render_points(
        self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1
    ) -> None:
        """Draw points, shape (N, 2), m."""
        self._points(
            np.asarray(points, np.float64).reshape(-1, np.shape(points)[-1]),
            color,
            FINER * max(size, 1.0),
        )

    def render_lines(self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1) -> None:
        """Draw a line through points, shape (N, 2), m."""
        self._line(np.asarray(points, np.float64), color, FINER * max(int(size), 1))

    def render_closed_lines(
        self, points: ArrayLike, color: Colour = (0, 0, 255), size: float = 1
    ) -> None:
        """Draw a line through points and back to the first."""
        self.render_lines(np.concatenate([points, np.asarray(points)[:1]]), color, size)


class Drawing(SimpleNamespace):
    """Drawing by a callback of generation A: attributes may be changed, and the renderer draws it.

    A list of points has ``vertices`` in pixels (:data:`PIXELS` per metre), with ``width`` numbers
    for each point.
    """

    def __init__(self, text: str = "", *args: Any, **named: Any) -> None:
        super().__init__(**{"text": text, "x": 0.0, "y": 0.0, "lists": {}} | named)

    __eq__, __hash__ = object.__eq__, object.__hash__  # type: ignore[assignment]

    def draw(self) -> None:
        """Do nothing: the renderer draws."""

    def delete(self) -> None:
        """Remove the drawing."""
        self.lists.pop(id(self), None)


class Batch(Drawing):
    """Collection of points from callbacks of generation A."""

    def add(self, count: int, mode: int, group: Any, *data: Any) -> Drawing:
        """Add points; ``data`` are ("v2f" or "v3f", numbers) and ("c3B", numbers)."""
        made = Drawing(mode=mode, vertices=[], colors=[], width=2, lists=self.lists)
        for item in data:
            name, values = item if isinstance(item, tuple | list) else (item, [0.0] * 3 * count)
            if name.startswith("v"):
                made.width, made.vertices = int(name[1]), list(values)
            elif name.startswith("c"):
                made.colors = list(values)
        self.lists[id(made)] = made
        return made


class EnvRenderer(_Painter):
    """Renderer for callbacks of generation A.

    ``left``, ``right``, ``top`` and ``bottom`` are the bounds of the visible area.
    """

    def __init__(
        self, loaded: GymMap, *, window: bool, width: int = 1000, height: int = 800
    ) -> None:
        super().__init__(loaded, width, height, window, 1000.0)
        self.left, self.right, self.bottom, self.top = (
            -0.5 * width,
            0.5 * width,
            -0.5 * height,
            0.5 * height,
        )
        self.zoom_level, self.batch, self.score_label = 1.2, Batch(), Drawing()
        self.cars: list[Drawing] = []
        self.poses: Any = None

    def update_obs(self, obs: dict[str, Any], states: NDArray[np.float64]) -> None:
        """Store the cars' poses."""
        self.ego_idx, self._states = obs["ego_idx"], states
        self.poses = np.stack((obs["poses_x"], obs["poses_y"], obs["poses_theta"]), axis=1)
        if len(self.cars) != len(self.poses):
            self.cars = [Drawing() for _ in self.poses]
        for car, pose in zip(self.cars, self.poses, strict=True):
            car.vertices = (
                (PIXELS * get_vertices(pose, F1TENTH.length, F1TENTH.width)).ravel().tolist()
            )
        count = obs["lap_counts"][self.ego_idx]
        self.score_label.text = f"Lap Time: {obs['lap_times'][0]:.2f}, Ego Lap Count: {count:.0f}"

    def draw(self, mode: str) -> Frame | None:
        """Show the frame, or return it in mode "rgb_array"; skip it if no window could show it."""
        if mode != "rgb_array" and self._window is None:
            return None
        across, high = (
            max(self.right - self.left, 1.0) / PIXELS,
            max(self.top - self.bottom, 1.0) / PIXELS,
        )
        x, y = 0.5 * (self.left + self.right) / PIXELS, 0.5 * (self.bottom + self.top) / PIXELS
        image = self._begin(x, y, FINER * min(self.width / across, self.height / high))
        for drawing in self.batch.lists.values():
            self._draw_list(drawing)
        self._draw_cars(self._states)
        if mode == "human":
            time.sleep(0.005)
        return self._end(image, str(self.score_label.text), mode != "rgb_array")

    def _draw_list(self, drawing: Drawing) -> None:
        numbers, width = np.asarray(drawing.vertices, np.float64), drawing.width
        points = numbers[: numbers.size // width * width].reshape(-1, width)[:, :2] / PIXELS
        colour = tuple(int(value) for value in list(drawing.colors)[:3]) or (183, 193, 222)
        if drawing.mode == 0:
            self._points(points, colour, FINER)
        elif drawing.mode in (2, 3):  # a closed line, a line
            self._line(
                np.concatenate([points, points[:1]]) if drawing.mode == 2 else points, colour, FINER
            )
        elif drawing.mode == 1:  # pairs
            for pair in points[: len(points) // 2 * 2].reshape(-1, 2, 2):
                self._line(pair, colour, FINER)
        elif len(points) > 2 and self._pen is not None:
            self._pen.polygon(self._camera.pixels(points).ravel().tolist(), fill=colour)

"""Frames of a race as arrays, for videos and for ``render_mode="rgb_array"``; needs only Pillow.

No display is needed. The track under the cars does not change, so it is painted once for a region
larger than the frame. Frames are cut out of this region until the camera leaves it.
"""

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Union

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pcs_racing.base.errors import InputError, check_choice, check_whole, require
from pcs_racing.base.packing import join_segments
from pcs_racing.race.painting import (
    COLOURS,
    FINER,
    Camera,
    paint_candidates,
    paint_car,
    paint_names,
    paint_obstacle,
    paint_plan,
    paint_track,
    paint_trails,
)
from pcs_racing.race.replay import Replay
from pcs_racing.race.state import MAX_CARS, MODES, views
from pcs_racing.track.frenet import SPEED
from pcs_racing.track.moving import moving_outlines

if TYPE_CHECKING:
    from pcs_racing.track.track import Track

_CLOSE = 9.0  # m across the smaller side of the frame in a view that follows a car
_MIN_CLOSE = 32.0  # min pixels per metre in such a view
_TEXT_HEIGHT = 32.0  # pixels: height of a line of text at the top


class Renderer:
    """Renderer of cars on a track, from above.

    Parameters
    ----------
    scene : Track or Replay
        Source of the walls and the race line.
    width, height : int
        Size of a frame in pixels, 64 to 4096.
    mode : str
        Mode: with ``"rgb_array"``, `render` returns the frame; with ``"human"``, it shows the frame
        in a window (needs the extra ``window``).
    view : str
        View: ``"track"`` shows the whole track, ``"car_0"`` to ``"car_7"`` follow a car, ``"both"``
        shows all cars.
    half_sizes : ndarray, shape (cars, 2), optional
        Half length and half width of each car in m; a replay has its own.
    fps : float
        Maximum frames per second in a window.
    """

    def __init__(
        self,
        scene: Union["Track", Replay],
        width: int = 960,
        height: int = 640,
        mode: str = "rgb_array",
        *,
        view: str = "track",
        half_sizes: np.ndarray | None = None,
        fps: float = 20.0,
    ) -> None:
        cars = len(scene.car_names) if isinstance(scene, Replay) else MAX_CARS
        self.mode, self.view = (
            check_choice("mode", mode, MODES),
            check_choice("view", view, views(cars)),
        )
        self.width, self.height = (
            check_whole("width", width, 64, 4096),
            check_whole("height", height, 64, 4096),
        )
        self.fps = fps
        self._shown: Track | Replay | None = None
        self.show(scene, half_sizes)
        self._font = ImageFont.load_default(16)
        self._window = Window(width, height, fps) if mode == "human" else None

    def show(self, scene: Union["Track", Replay], half_sizes: np.ndarray | None = None) -> None:
        """Switch to another track or replay, and to cars of other half sizes if they are given."""
        if scene is not self._shown:
            walls, self._line, self._line_speed, self._half_sizes = _scene(scene)
            self._walls = join_segments(walls)
            self._track = None if isinstance(scene, Replay) else scene.arrays
            corners = np.vstack([self._line, *self._walls])
            self._low, self._high = corners.min(axis=0), corners.max(axis=0)
            self._ground: tuple[tuple[float, ...], Image.Image] | None = None
            self._shown = scene
        if half_sizes is not None:
            self._half_sizes = np.asarray(half_sizes, float)

    def render(
        self,
        cars: np.ndarray,
        *,
        plans: Sequence[np.ndarray] | np.ndarray | None = None,
        candidates: np.ndarray | None = None,
        costs: np.ndarray | None = None,
        trails: np.ndarray | None = None,
        names: Sequence[str] = (),
        text: str = "",
        time: float = 0.0,
    ) -> np.ndarray | None:
        """Draw one moment.

        Parameters
        ----------
        cars : ndarray, shape (1 to 8, 7)
            States x, y, delta, v, psi, psi_dot, beta.
        plans : ndarray, shape (cars, P, 2 or more), optional
            Plan of each car: x, y first; rows of NaN are left out.
        candidates : ndarray, shape (cars, C, P, 2), optional
            Considered paths, with ``costs`` of shape (cars, C), infinite for a rejected path.
        trails : ndarray, shape (M, cars, 2), optional
            Past positions of the cars, oldest first.
        names : sequence of str
            Label of each car, drawn next to it in its colour; cut after 24 characters.
        text : str
            Line of text in the corner.
        time : float
            Time of the race, s, for the moving obstacles of a track.

        Returns
        -------
        ndarray of uint8, shape (height, width, 3), or None
            Frame; None in a window (``mode="human"``).
        """
        cars = np.asarray(cars, float)
        if (
            cars.ndim != 2
            or not 1 <= len(cars) <= MAX_CARS
            or cars.shape[1] != 7
            or not np.all(np.isfinite(cars))
        ):
            raise InputError(
                f"cars must be finite and have shape (1, 7) to ({MAX_CARS}, 7), got shape"
                f" {cars.shape}"
            )
        camera = self._aim(cars)
        image = self._background(camera)
        pen = ImageDraw.Draw(image, "RGBA")
        if trails is not None:
            paint_trails(pen, camera, np.asarray(trails, float))
        if candidates is not None and costs is not None:
            for paths, prices in zip(candidates, costs, strict=True):
                paint_candidates(pen, camera, np.asarray(paths), np.asarray(prices))
        for corners in () if self._track is None else moving_outlines(self._track, time):
            paint_obstacle(pen, camera, corners)
        for car, plan in enumerate(plans if plans is not None else ()):
            paint_plan(pen, camera, COLOURS[f"car{car}"], plan)
        # Car 0 comes last: where cars overlap, the watched car is on top.
        for car in reversed(range(len(cars))):
            paint_car(pen, camera, COLOURS[f"car{car}"], cars[car], self._half_sizes[car])
        # Names are written after the reduction, which would blur them.
        image = image.reduce(FINER)
        if names:
            top = _TEXT_HEIGHT if text else 0.0
            paint_names(image, camera, cars, self._half_sizes, names, self._font, top)
        if text:
            ImageDraw.Draw(image).text((14, 10), text, fill=COLOURS["ink"], font=self._font)
        frame = np.array(image)
        if self._window is None:
            return frame
        self._window.show(frame)
        return None

    def close(self) -> None:
        """Close the window, if there is a window."""
        if self._window is not None:
            self._window.close()

    def _aim(self, cars: np.ndarray) -> Camera:
        """Return the current camera, in whole fine pixels: the background needs no resampling."""
        size = np.array([self.width, self.height]) * FINER
        whole = float(np.min(0.91 * size / np.maximum(self._high - self._low, 1e-3)))
        close = max(float(min(size)) / _CLOSE, FINER * _MIN_CLOSE, whole)
        middle, scale = 0.5 * (self._low + self._high), whole
        if self.view == "both":
            low, high = cars[:, :2].min(axis=0), cars[:, :2].max(axis=0)
            middle = 0.5 * (low + high)
            wanted = float(np.min(size / (high - low + 0.6 * _CLOSE)))
            # Whole steps of zoom: between two steps the background can be reused.
            scale = float(np.clip(2.0 ** (np.floor(4.0 * np.log2(wanted)) / 4.0), whole, close))
        elif self.view != "track":
            middle, scale = cars[min(int(self.view[-1]), len(cars) - 1), :2], close
        x, y = np.rint(middle * scale) / scale
        return Camera(float(x), float(y), scale, self.width * FINER, self.height * FINER)

    def _background(self, camera: Camera) -> Image.Image:
        """Return the track in the frame, cut out of a region half as large again.

        A new region is painted where the last region does not reach.
        """
        width, height = camera.width, camera.height
        step_x, step_y = width // 2, height // 2
        column, row = round(camera.x * camera.scale), round(camera.y * camera.scale)
        place = (round(column / step_x), round(row / step_y))
        if self.view == "track":
            step_x = step_y = 0
            place = (0, 0)
        key = (*place, camera.scale)
        if self._ground is None or self._ground[0] != key:
            middle = (
                (column, row) if self.view == "track" else (place[0] * step_x, place[1] * step_y)
            )
            at = middle[0] / camera.scale, middle[1] / camera.scale
            region = Camera(*at, camera.scale, width + step_x, height + step_y)
            painted = paint_track(region, self._walls, self._line, self._line_speed)
            self._ground = key, painted
        if self.view == "track":
            return self._ground[1].copy()
        left, top = column - place[0] * step_x + step_x // 2, place[1] * step_y - row + step_y // 2
        return self._ground[1].crop((left, top, left + width, top + height))


class Window:
    """Window that shows frames of one size."""

    def __init__(self, width: int, height: int, fps: float) -> None:
        require("pygame", extra="window")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        self._pygame, self._size, self.fps = pygame, (width, height), fps
        self._surface: Any = None

    def show(self, frame: np.ndarray) -> None:
        """Show a frame, in a new window if none is open; closing it stops only the display."""
        pygame = self._pygame
        if self._surface is None:
            try:
                pygame.display.init()
                self._surface = pygame.display.set_mode(self._size)
            except pygame.error as error:
                raise RuntimeError(
                    f"can't open a window ({error}); mode='rgb_array' needs no display"
                ) from None
            pygame.display.set_caption("pcs-racing")
            self._clock = pygame.time.Clock()
        pygame.event.pump()
        self._surface.blit(pygame.image.frombuffer(frame.tobytes(), self._size, "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window, if it was opened."""
        if self._surface is not None:
            self._pygame.display.quit()
            self._surface = None


def _scene(
    scene: Union["Track", Replay],
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Return the walls, the race line, the speed on it and the half sizes of the cars."""
    if isinstance(scene, Replay):
        return scene.walls, scene.line, scene.line_speed, np.asarray(scene.half_sizes)
    arrays = getattr(scene, "arrays", None)
    if arrays is None:
        raise InputError(f"scene must be a Track or a Replay, got {type(scene).__name__}")
    sizes = np.full((MAX_CARS, 2), (0.29, 0.155))
    return arrays.walls, arrays.line[:, :2], arrays.line[:, SPEED], sizes

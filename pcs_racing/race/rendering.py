"""Frames of a race as arrays, for videos and for ``render_mode="rgb_array"``: no display, nothing but Pillow.

A frame is drawn at twice its size and reduced, which smooths every edge. The track under the cars does not change, so
it is drawn once for a region larger than the frame and cut out until the camera leaves it.
"""

import os
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Union

import numpy as np
from PIL import Image, ImageChops, ImageDraw, ImageFont

from pcs_racing.base.checks import check_choice, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.packing import join_segments
from pcs_racing.car.vehicle import LENGTH, WIDTH
from pcs_racing.race.replay import Replay
from pcs_racing.track.frenet import SPEED

if TYPE_CHECKING:
    from pcs_racing.track.track import Track

__all__ = ["MODES", "THEMES", "VIEWS", "Renderer", "half_sizes", "replay_frames", "write_gif"]

MODES = ("rgb_array", "human")
VIEWS = ("track", "both", "car_0", "car_1")

# The colours of replay.html; names are darker in the light theme, for letters need more contrast than cars.
_THEMES = {
    "light": {
        "ground": "#e3e8ed", "asphalt": "#fdfdfe", "wall": "#7c8897", "ink": "#17202b", "tyre": "#1c232c",
        "car0": "#1b6fd8", "car1": "#e08700", "slow": "#9a5fc0", "mid": "#6f8fd0", "fast": "#2fb3a0",
        "best": "#00695c", "worst": "#c9d3d6", "rejected": "#d12c4c",
        "name0": "#1559b0", "name1": "#945900",
    },
    "dark": {
        "ground": "#0c1117", "asphalt": "#222c37", "wall": "#74869b", "ink": "#e6ebf1", "tyre": "#070a0e",
        "car0": "#58a6ff", "car1": "#ffb03b", "slow": "#a772cf", "mid": "#6d8ed6", "fast": "#36c5ae",
        "best": "#8ef5d6", "worst": "#35454f", "rejected": "#ff5570",
        "name0": "#58a6ff", "name1": "#ffb03b",
    },
}  # fmt: skip
THEMES = tuple(_THEMES)

_FINER = 2
_CLOSE = 9.0  # m across the smaller side of the frame when a car is followed
_LEAST_CLOSE = 32.0  # pixels per metre then, however small the frame
_TRAIL = 2.0  # s
_BODY = (
    (0.97, 0.2),
    (0.3, 0.4),
    (-0.15, 0.62),
    (-0.85, 0.55),
    (-0.85, -0.55),
    (-0.15, -0.62),
    (0.3, -0.4),
    (0.97, -0.2),
)
_COCKPIT = ((0.2, 0.22), (-0.12, 0.34), (-0.3, 0.26), (-0.3, -0.26), (-0.12, -0.34), (0.2, -0.22))
_ARROW = ((1.15, 0.0), (-1.0, 1.7), (-0.6, 0.0), (-1.0, -1.7))
_AHEAD = ((1.85, 0.0), (1.25, 0.8), (1.42, 0.0), (1.25, -0.8))
_LEAST_CAR = 8.0  # pixels of half a length: a smaller car is an arrow of _ARROW_SIZE
_ARROW_SIZE = 11.0
_NAME = 24  # characters of a name
_TEXT_HEIGHT = 32.0  # pixels at the top that a line of text takes
_HALO = 3  # pixels around the letters of a name
_WHEELS = ((0.55, 0.8), (0.55, -0.8), (-0.57, 0.8), (-0.57, -0.8))

Colour = tuple[int, ...]


class _Camera(NamedTuple):
    """What the middle of the frame shows (m), and fine pixels per metre."""

    x: float
    y: float
    scale: float


class Renderer:
    """Draws cars on a track from above.

    Parameters
    ----------
    scene : Track or Replay
        Whose walls and race line to draw.
    width, height : int
        Size of a frame in pixels, 64 to 4096.
    mode : str
        ``"rgb_array"``: `render` returns the frame; ``"human"``: it shows it in a window (needs the extra ``window``).
    view : str
        ``"track"`` shows the whole track, ``"car_0"`` and ``"car_1"`` follow a car, ``"both"`` keeps all cars in sight.
    theme : str
        ``"light"`` or ``"dark"``.
    half_sizes : ndarray, shape (2, 2), optional
        Half length and half width of each car in m; a replay brings its own.
    fps : float
        Frames per second at most in a window.

    Raises
    ------
    InputError
        If an argument is none of these.
    ImportError
        If ``mode="human"`` and pygame-ce is not installed.
    """

    def __init__(
        self,
        scene: Union["Track", Replay],
        width: int = 960,
        height: int = 640,
        mode: str = "rgb_array",
        *,
        view: str = "track",
        theme: str = "light",
        half_sizes: np.ndarray | None = None,
        fps: float = 20.0,
    ) -> None:
        self.mode, self.view = check_choice("mode", mode, MODES), check_choice("view", view, VIEWS)
        check_choice("theme", theme, THEMES)
        self.width, self.height = check_whole("width", width, 64, 4096), check_whole("height", height, 64, 4096)
        self.fps = fps
        self._colours = {name: _rgb(colour) for name, colour in _THEMES[theme].items()}
        self._shown: Track | Replay | None = None
        self.show(scene, half_sizes)
        self._font = ImageFont.load_default(16)
        self._window: Any = None
        self._pygame = _import_pygame() if mode == "human" else None

    def show(self, scene: Union["Track", Replay], half_sizes: np.ndarray | None = None) -> None:
        """Draw another track or replay from now on, and cars of other half sizes if they are given."""
        if scene is not self._shown:
            walls, self._line, self._line_speed, self._half_sizes = _scene(scene)
            self._walls = join_segments(walls)
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
    ) -> np.ndarray | None:
        """Draw one moment.

        Parameters
        ----------
        cars : ndarray, shape (1 or 2, 7)
            States x, y, delta, v, psi, psi_dot, beta.
        plans : ndarray, shape (cars, P, 2 or more), optional
            The plan of each car: x, y first; rows of NaN are left out.
        candidates : ndarray, shape (cars, C, P, 2), optional
            Paths considered, with their ``costs`` (cars, C), infinite for a rejected one.
        trails : ndarray, shape (M, cars, 2), optional
            Where the cars have been, oldest first.
        names : sequence of str
            A label for each car, drawn beside it in its colour; cut after 24 characters.
        text : str
            A line in the corner.

        Returns
        -------
        ndarray of uint8, shape (height, width, 3), or None
            None in a window (``mode="human"``).

        Raises
        ------
        InputError
            If ``cars`` has another shape or is not finite.
        """
        cars = np.asarray(cars, float)
        if cars.ndim != 2 or cars.shape[0] not in (1, 2) or cars.shape[1] != 7 or not np.all(np.isfinite(cars)):
            raise InputError(f"cars must be finite and have shape (1, 7) or (2, 7), got shape {cars.shape}")
        camera = self._aim(cars)
        image = self._background(camera)
        pen = ImageDraw.Draw(image, "RGBA")
        if trails is not None:
            self._draw_trails(pen, camera, np.asarray(trails, float))
        if candidates is not None and costs is not None:
            for paths, prices in zip(candidates, costs, strict=True):
                self._draw_candidates(pen, camera, np.asarray(paths), np.asarray(prices))
        for car, plan in enumerate(plans if plans is not None else ()):
            points = self._to_pixels(camera, _known(plan))
            if len(points) > 1:
                pen.line(_flat(points), fill=self._colours[f"car{car}"], width=3 * _FINER, joint="curve")
        for car in reversed(range(len(cars))):
            self._draw_car(pen, camera, car, cars[car])
        image = image.reduce(_FINER)
        pen = ImageDraw.Draw(image)
        if names:
            self._draw_names(pen, camera, cars, names, _TEXT_HEIGHT if text else 0.0)
        if text:
            pen.text((14, 10), text, fill=self._colours["ink"], font=self._font)
        frame = np.array(image)
        if self.mode == "human":
            self._show(frame)
            return None
        return frame

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None and self._pygame is not None:
            self._pygame.display.quit()
            self._window = None

    def _aim(self, cars: np.ndarray) -> _Camera:
        """The camera of this moment, in whole fine pixels, so that the background needs no resampling."""
        size = np.array([self.width, self.height]) * _FINER
        whole = float(np.min(0.91 * size / np.maximum(self._high - self._low, 1e-3)))
        close = max(float(min(size)) / _CLOSE, _FINER * _LEAST_CLOSE, whole)
        middle, scale = 0.5 * (self._low + self._high), whole
        if self.view == "both":
            low, high = cars[:, :2].min(axis=0), cars[:, :2].max(axis=0)
            middle = 0.5 * (low + high)
            wanted = float(np.min(size / (high - low + 0.6 * _CLOSE)))
            # Whole steps of zoom: between them the background can be kept.
            scale = float(np.clip(2.0 ** (np.floor(4.0 * np.log2(wanted)) / 4.0), whole, close))
        elif self.view != "track":
            middle, scale = cars[min(int(self.view[-1]), len(cars) - 1), :2], close
        x, y = np.rint(middle * scale) / scale
        return _Camera(float(x), float(y), scale)

    def _to_pixels(self, camera: _Camera, points: np.ndarray) -> np.ndarray:
        """Fine pixels of points in m."""
        origin = np.array([self.width, self.height]) * (0.5 * _FINER)
        return origin + (points[..., :2] - (camera.x, camera.y)) * (camera.scale, -camera.scale)

    def _background(self, camera: _Camera) -> Image.Image:
        """The track in the frame, cut out of a region half as large again, drawn where the last one does not reach."""
        width, height = self.width * _FINER, self.height * _FINER
        step_x, step_y = width // 2, height // 2
        column, row = round(camera.x * camera.scale), round(camera.y * camera.scale)
        place = (round(column / step_x), round(row / step_y))
        if self.view == "track":
            step_x = step_y = 0
            place = (0, 0)
        key = (*place, camera.scale)
        if self._ground is None or self._ground[0] != key:
            middle = (column, row) if self.view == "track" else (place[0] * step_x, place[1] * step_y)
            region = _Camera(middle[0] / camera.scale, middle[1] / camera.scale, camera.scale)
            self._ground = key, self._draw_track(region, width + step_x, height + step_y)
        if self.view == "track":
            return self._ground[1].copy()
        left, top = column - place[0] * step_x + step_x // 2, place[1] * step_y - row + step_y // 2
        return self._ground[1].crop((left, top, left + width, top + height))

    def _draw_track(self, camera: _Camera, width: int, height: int) -> Image.Image:
        """Surface, walls and race line around the camera."""
        scale = np.array([camera.scale, -camera.scale])

        def pixels(points: np.ndarray) -> np.ndarray:
            return np.array([width, height]) / 2 + (points - (camera.x, camera.y)) * scale

        image = Image.new("RGB", (width, height), self._colours["ground"])
        surface = Image.new("L", (width, height))
        for wall in self._walls:
            if len(wall) > 3 and np.array_equal(wall[0], wall[-1]):
                inside = Image.new("L", (width, height))
                ImageDraw.Draw(inside).polygon(_flat(pixels(wall)), fill=255)
                surface = ImageChops.difference(surface, inside)  # loops within loops are holes
        image.paste(self._colours["asphalt"], mask=surface)
        pen = ImageDraw.Draw(image)
        closed = np.vstack([self._line, self._line[:1]])
        stops = [self._colours[name] for name in ("slow", "mid", "fast")]
        speed = self._line_speed
        if speed is None:
            pen.line(_flat(pixels(closed)), fill=self._colours["wall"], width=_FINER)
        else:
            share = (speed - speed.min()) / max(float(np.ptp(speed)), 1e-9)
            for i, (start, end) in enumerate(zip(pixels(closed[:-1]), pixels(closed[1:]), strict=True)):
                pen.line([*start, *end], fill=_between(stops, float(share[i])), width=round(1.5 * _FINER))
        for wall in self._walls:
            pen.line(_flat(pixels(wall)), fill=self._colours["wall"], width=round(1.6 * _FINER), joint="curve")
        return image

    def _draw_trails(self, pen: ImageDraw.ImageDraw, camera: _Camera, trails: np.ndarray) -> None:
        width = max(round(0.13 * camera.scale), 2 * _FINER)
        for car in range(trails.shape[1]):
            points = self._to_pixels(camera, trails[:, car])
            for i in range(len(points) - 1):
                alpha = round(120 * ((i + 1) / len(points)) ** 1.6)
                pen.line([*points[i], *points[i + 1]], fill=(*self._colours[f"car{car}"], alpha), width=width)

    def _draw_candidates(self, pen: ImageDraw.ImageDraw, camera: _Camera, paths: np.ndarray, costs: np.ndarray) -> None:
        """Rejected paths in red, the others shaded by the rank of their cost, the best on top."""
        order = np.argsort(-costs, kind="stable")
        kept = int(np.count_nonzero(np.isfinite(costs)))
        stops = [self._colours["worst"], self._colours["best"]]
        for i, path in enumerate(order):
            points = self._to_pixels(camera, _known(paths[path]))
            if len(points) < 2:
                continue
            good = (i - (len(costs) - kept)) / max(kept - 1, 1)
            colour = (*self._colours["rejected"], 90) if good < 0.0 else (*_between(stops, good**1.7), 190)
            pen.line(_flat(points), fill=colour, width=_FINER)

    def _draw_car(self, pen: ImageDraw.ImageDraw, camera: _Camera, car: int, state: np.ndarray) -> None:
        half_length, half_width = self._half_sizes[min(car, len(self._half_sizes) - 1)]
        x, y, delta, _, psi = state[:5]
        colour = self._colours[f"car{car}"]

        def place(shape: Sequence[Sequence[float]], factor: float = 1.0) -> list[float]:
            corners = np.array(shape) * (half_length * factor, half_width * factor)
            turn = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]])
            return _flat(self._to_pixels(camera, np.array([x, y]) + corners @ turn))

        if half_length * camera.scale < _LEAST_CAR * _FINER:
            # On a whole track an arrow larger than the car: small, but never lost.
            pen.polygon(place(_ARROW, _ARROW_SIZE * _FINER / (half_length * camera.scale)), fill=colour)
            return
        pen.polygon(place(_AHEAD), fill=colour)
        box = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        pen.polygon(place(box), fill=(*colour, 50), outline=(*colour, 160), width=_FINER)
        for at_x, at_y in _WHEELS:
            turn = delta if at_x > 0 else 0.0
            along = np.array([0.2 * half_length * np.cos(turn), 0.2 * half_length * np.sin(turn)])
            across = np.array([-0.17 * half_width * np.sin(turn), 0.17 * half_width * np.cos(turn)])
            centre = np.array([at_x * half_length, at_y * half_width])
            tyre = [centre + along + across, centre - along + across, centre - along - across, centre + along - across]
            pen.polygon(place([corner / (half_length, half_width) for corner in tyre]), fill=self._colours["tyre"])
        pen.polygon(place(_BODY), fill=colour)
        for front, width in ((0.92, 0.72), (-0.9, 0.8)):
            pen.polygon(
                place(((front + 0.05, width), (front - 0.05, width), (front - 0.05, -width), (front + 0.05, -width))),
                fill=colour,
            )
        pen.polygon(place(_COCKPIT), fill=self._colours["tyre"])

    def _draw_names(
        self, pen: ImageDraw.ImageDraw, camera: _Camera, cars: np.ndarray, names: Sequence[str], top: float
    ) -> None:
        """Write who drives each car beside it, away from the other car, within the frame and below its line of text."""
        places = self._to_pixels(camera, cars[:, :2]) / _FINER
        for car, name in enumerate(names[: len(cars)]):
            apart = places[car] - places[1 - car] if len(cars) == 2 else np.zeros(2)
            distance = float(np.hypot(*apart))
            # Cars at one place, or one car alone: the first name above, the second below.
            away = apart / distance if distance > 1.0 else np.array([0.0, 1.0 if car else -1.0])
            box = np.array(pen.textbbox((0, 0), name[:_NAME], font=self._font, stroke_width=_HALO))
            half = 0.5 * (box[2:] - box[:2])
            half_length = self._half_sizes[min(car, len(self._half_sizes) - 1), 0] * camera.scale / _FINER
            gap = 4.0 + (_ARROW_SIZE * 1.7 if half_length < _LEAST_CAR else _AHEAD[0][0] * half_length)
            # So far that the box of the text, seen in this direction, ends a gap before the car.
            reach = gap + float(np.min(half / np.maximum(np.abs(away), 1e-6)))
            low = half + np.array([0.0, top])
            middle = np.clip(places[car] + away * reach, low, np.maximum((self.width, self.height) - half, low))
            corner = middle - half - box[:2]
            pen.text(
                (float(corner[0]), float(corner[1])),
                name[:_NAME],
                fill=self._colours[f"name{car}"],
                font=self._font,
                stroke_width=_HALO,
                stroke_fill=self._colours["asphalt"],
            )

    def _show(self, frame: np.ndarray) -> None:
        """Put a frame into the window, opening it first; closing it by hand ends nothing but the showing."""
        pygame = self._pygame
        if pygame is None:
            return
        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode((self.width, self.height))
            except pygame.error as error:
                raise RuntimeError(f"can't open a window ({error}); mode='rgb_array' needs no display") from None
            pygame.display.set_caption("pcs-racing")
            self._clock = pygame.time.Clock()
        pygame.event.pump()
        self._window.blit(pygame.image.frombuffer(frame.tobytes(), (self.width, self.height), "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)


def replay_frames(
    replay: Replay, renderer: Renderer | None = None, *, fps: float = 20.0, speed: float = 1.0, candidates: bool = False
) -> Iterator[np.ndarray]:
    """Frames of a recorded race, one after the other, for any video writer.

    Parameters
    ----------
    replay : Replay
    renderer : Renderer, optional
        In mode ``"rgb_array"``; one of the whole track if left out.
    fps : float
        Frames per second of the video.
    speed : float
        Race seconds per video second.
    candidates : bool
        Whether to draw the paths considered, where they were kept.

    Yields
    ------
    ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    InputError
        If ``fps`` or ``speed`` is not positive, or the renderer shows a window.
    """
    if not (0.0 < fps <= 1000.0 and 0.0 < speed <= 1000.0):
        raise InputError(f"fps and speed must be positive and at most 1000, got {fps!r} and {speed!r}")
    renderer = renderer or Renderer(replay)
    if renderer.mode != "rgb_array":
        raise InputError("frames of a replay need a renderer in mode 'rgb_array'")
    return _frames(replay, renderer, speed / fps, candidates)


def _frames(replay: Replay, renderer: Renderer, step: float, candidates: bool) -> Iterator[np.ndarray]:
    lead = replay.lead
    for k in range(int(replay.duration / step + 1e-9) + 1):
        time = k * step
        i = min(round(time / replay.frame_dt), len(replay.cars) - 1)
        since = max(0, i - round(_TRAIL / replay.frame_dt))
        leader = 0 if lead[i] >= 0.0 else 1
        shown: dict[str, Any] = {}
        plan = int(time / replay.plan_dt + 1e-6)
        if replay.paths is not None and len(replay.paths):
            shown["plans"] = replay.paths[min(plan, len(replay.paths) - 1)]
        if candidates and replay.candidates is not None and replay.costs is not None:
            row = int(np.searchsorted(np.asarray(replay.candidate_steps), plan, side="right")) - 1
            if row >= 0:
                shown |= {"candidates": replay.candidates[row], "costs": replay.costs[row]}
        frame = renderer.render(
            replay.cars[i],
            trails=replay.cars[since : i + 1, :, :2],
            names=replay.car_names,
            text=f"{time:.1f} s    {replay.car_names[leader]:.60} leads by {abs(lead[i]):.1f} m",
            **shown,
        )
        if frame is not None:
            yield frame


def write_gif(
    replay: Replay,
    path: str | os.PathLike[str],
    *,
    renderer: Renderer | None = None,
    fps: float = 10.0,
    speed: float = 2.0,
    candidates: bool = False,
) -> Path:
    """Write a recorded race as an animated GIF.

    Parameters
    ----------
    replay : Replay
    path : path
        Ends in ``.gif``; an existing file is replaced in one step.
    renderer : Renderer, optional
        One of the whole track, 640 x 420 pixels, if left out.
    fps : float
        Frames per second, up to 50 (a GIF counts in hundredths of a second).
    speed : float
        Race seconds per second.
    candidates : bool
        Whether to draw the paths considered.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If an argument is impossible or the folder does not exist.
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise InputError(f"write_gif writes .gif files, got {path.name!r}")
    if not 0.0 < fps <= 50.0:
        raise InputError(f"fps must be above 0 and at most 50, got {fps!r}")
    frames = replay_frames(replay, renderer or Renderer(replay, 640, 420), fps=fps, speed=speed, candidates=candidates)
    first = Image.fromarray(next(frames)).quantize(128)
    # One palette for all frames: smaller, faster, and nothing flickers.
    rest = (Image.fromarray(frame).quantize(palette=first, dither=Image.Dither.NONE) for frame in frames)
    write_atomically(
        path,
        lambda file: first.save(
            file, "GIF", save_all=True, append_images=rest, duration=round(100 / fps) * 10, loop=0, optimize=False
        ),
    )
    return path


def half_sizes(vehicles: np.ndarray) -> np.ndarray:
    """Half length and half width, m, of cars by their parameter rows, shape (..., 18)."""
    return 0.5 * np.asarray(vehicles)[..., [LENGTH, WIDTH]]


def _scene(scene: Union["Track", Replay]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Walls, race line, speed on it and half sizes of the cars."""
    if isinstance(scene, Replay):
        return scene.walls, scene.line, scene.line_speed, np.asarray(scene.half_sizes)
    arrays = getattr(scene, "arrays", None)
    if arrays is None:
        raise InputError(f"scene must be a Track or a Replay, got {type(scene).__name__}")
    return arrays.walls, arrays.line[:, :2], arrays.line[:, SPEED], np.full((2, 2), (0.29, 0.155))


def _import_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        return import_module("pygame")
    except ImportError:
        raise ImportError("mode='human' needs pygame-ce: pip install \"pcs-racing[window]\"") from None


def _rgb(colour: str) -> Colour:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def _between(stops: Sequence[Colour], share: float) -> Colour:
    """The colour at a share from 0 to 1 of the way along some stops."""
    at = min(max(share, 0.0), 1.0) * (len(stops) - 1)
    i = min(int(at), len(stops) - 2)
    return tuple(round(a + (b - a) * (at - i)) for a, b in zip(stops[i], stops[i + 1], strict=True))


def _known(points: np.ndarray) -> np.ndarray:
    """The points of a path that are not NaN."""
    points = np.asarray(points)
    return points[~np.isnan(points[:, :2]).any(axis=1)]


def _flat(points: np.ndarray) -> list[float]:
    return [float(value) for value in np.asarray(points).ravel()]

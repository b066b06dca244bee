"""Painting of the parts of a frame: the track, the paths, the cars and their names.

All parts are painted in fine pixels, :data:`FINER` per pixel of the frame, so that every edge is
smooth in the reduced picture. Only names are painted after the reduction, in pixels.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageChops, ImageDraw

FINER = 2
"""Fine pixels across a pixel of the frame."""

Colour = tuple[int, ...]
Colours = Mapping[str, Colour]

# The light colours of replay.html; names are darker: letters need more contrast than cars.
_CODES = {
    "ground": "#e3e8ed",
    "asphalt": "#fdfdfe",
    "wall": "#7c8897",
    "ink": "#17202b",
    "tyre": "#1c232c",
    "slow": "#9a5fc0",
    "mid": "#6f8fd0",
    "fast": "#2fb3a0",
    "best": "#00695c",
    "worst": "#c9d3d6",
    "rejected": "#d12c4c",
    "car0": "#1b6fd8",
    "car1": "#e08700",
    "car2": "#22964f",
    "car3": "#c03fa0",
    "car4": "#8a5a2b",
    "car5": "#008fa6",
    "car6": "#8c8f00",
    "car7": "#5b6775",
    "name0": "#1559b0",
    "name1": "#945900",
    "name2": "#0f5a2c",
    "name3": "#7a2466",
    "name4": "#553517",
    "name5": "#005765",
    "name6": "#555700",
    "name7": "#323a44",
}
COLOURS: Colours = {
    name: tuple(int(code[i : i + 2], 16) for i in (1, 3, 5)) for name, code in _CODES.items()
}
"""Colours by purpose."""

# Shapes in units of half a car's length and width, x to the front.
_LEFT_HALF = ((0.97, 0.2), (0.3, 0.4), (-0.15, 0.62), (-0.85, 0.55))
_BODY = (*_LEFT_HALF, *((x, -y) for x, y in reversed(_LEFT_HALF)))
_COCKPIT = ((0.2, 0.22), (-0.12, 0.34), (-0.3, 0.26), (-0.3, -0.26), (-0.12, -0.34), (0.2, -0.22))
_ARROW = ((1.15, 0.0), (-1.0, 1.7), (-0.6, 0.0), (-1.0, -1.7))
_AHEAD = ((1.85, 0.0), (1.25, 0.8), (1.42, 0.0), (1.25, -0.8))
_WHEELS = ((0.55, 0.8), (0.55, -0.8), (-0.57, 0.8), (-0.57, -0.8))
_MIN_CAR = 8.0  # pixels of half a length: a smaller car is drawn as an arrow of _ARROW_SIZE
_ARROW_SIZE = 11.0
_NAME = 24  # max characters of a name
_HALO = 3  # pixels around the letters of a name


class Camera(NamedTuple):
    """Section of the plane in a picture: middle (m), fine pixels per metre, size in fine pixels."""

    x: float
    y: float
    scale: float
    width: int
    height: int

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return the fine pixels of points in m, shape (..., 2)."""
        origin = np.array([self.width, self.height]) * 0.5
        return origin + (points[..., :2] - (self.x, self.y)) * (self.scale, -self.scale)


def paint_track(
    camera: Camera, walls: Sequence[np.ndarray], line: np.ndarray, speed: np.ndarray | None
) -> Image.Image:
    """Return a picture of the surface, the walls (polylines) and the race line.

    The line is coloured by speed, grey where the speed is unknown (NaN, or no ``speed``). Where
    walls form closed loops, the track lies between them.
    """
    size = (camera.width, camera.height)
    image = Image.new("RGB", size, COLOURS["ground"])
    surface = Image.new("L", size)
    for wall in walls:
        if len(wall) > 3 and np.array_equal(wall[0], wall[-1]):
            inside = Image.new("L", size)
            ImageDraw.Draw(inside).polygon(_flat(camera.pixels(wall)), fill=255)
            surface = ImageChops.difference(surface, inside)  # loops within loops are holes
    image.paste(COLOURS["asphalt"], mask=surface)
    pen = ImageDraw.Draw(image)
    closed = camera.pixels(np.vstack([line, line[:1]]))
    if speed is None:
        pen.line(_flat(closed), fill=COLOURS["wall"], width=FINER)
    else:
        stops = [COLOURS[name] for name in ("slow", "mid", "fast")]
        low, high = float(np.nanmin(speed)), float(np.nanmax(speed))
        shares = ((speed - low) / max(high - low, 1e-9)).tolist()
        for share, (start, end) in zip(shares, pairwise(closed), strict=True):
            colour = COLOURS["wall"] if np.isnan(share) else _between(stops, share)
            pen.line([*start, *end], fill=colour, width=round(1.5 * FINER))
    for wall in walls:
        pen.line(
            _flat(camera.pixels(wall)),
            fill=COLOURS["wall"],
            width=round(1.6 * FINER),
            joint="curve",
        )
    return image


def paint_trails(pen: ImageDraw.ImageDraw, camera: Camera, trails: np.ndarray) -> None:
    """Paint past positions of the cars, shape (M, cars, 2), oldest first and faintest."""
    width = max(round(0.13 * camera.scale), 2 * FINER)
    for car in range(trails.shape[1]):
        points = camera.pixels(trails[:, car])
        for i in range(len(points) - 1):
            alpha = round(120 * ((i + 1) / len(points)) ** 1.6)
            pen.line([*points[i], *points[i + 1]], fill=(*COLOURS[f"car{car}"], alpha), width=width)


def paint_candidates(
    pen: ImageDraw.ImageDraw, camera: Camera, paths: np.ndarray, costs: np.ndarray
) -> None:
    """Paint rejected paths in red, other paths shaded by rank of cost, the best on top."""
    order = np.argsort(-costs, kind="stable")
    kept = int(np.count_nonzero(np.isfinite(costs)))
    stops = [COLOURS["worst"], COLOURS["best"]]
    for i, path in enumerate(order):
        points = camera.pixels(_known(paths[path]))
        if len(points) < 2:
            continue
        good = (i - (len(costs) - kept)) / max(kept - 1, 1)
        colour = (*COLOURS["rejected"], 90) if good < 0.0 else (*_between(stops, good**1.7), 190)
        pen.line(_flat(points), fill=colour, width=FINER)


def paint_obstacle(pen: ImageDraw.ImageDraw, camera: Camera, corners: np.ndarray) -> None:
    """Paint an obstacle, a polygon of corners (m)."""
    pen.polygon(_flat(camera.pixels(corners)), fill=COLOURS["wall"])


def paint_plan(pen: ImageDraw.ImageDraw, camera: Camera, colour: Colour, plan: np.ndarray) -> None:
    """Paint the path that a car follows."""
    points = camera.pixels(_known(plan))
    if len(points) > 1:
        pen.line(_flat(points), fill=colour, width=3 * FINER, joint="curve")


def paint_car(
    pen: ImageDraw.ImageDraw,
    camera: Camera,
    colour: Colour,
    state: np.ndarray,
    half_size: np.ndarray,
) -> None:
    """Paint a car with turned front wheels, or an arrow if the car would be too small to see."""
    half_length, half_width = half_size
    x, y, delta, _, psi = state[:5]

    def place(shape: Any, factor: float = 1.0) -> list[float]:
        corners = np.array(shape) * (half_length * factor, half_width * factor)
        turn = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]])
        return _flat(camera.pixels(np.array([x, y]) + corners @ turn))

    if half_length * camera.scale < _MIN_CAR * FINER:
        # In a view of the whole track the arrow is larger than the car: small, but always visible.
        pen.polygon(place(_ARROW, _ARROW_SIZE * FINER / (half_length * camera.scale)), fill=colour)
        return
    # The true rectangle is painted pale under the car: contacts depend on it, not on the drawn
    # body.
    pen.polygon(place(_AHEAD), fill=colour)
    box = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    pen.polygon(place(box), fill=(*colour, 50), outline=(*colour, 160), width=FINER)
    for at_x, at_y in _WHEELS:
        turn = delta if at_x > 0 else 0.0
        along = np.array([0.2 * half_length * np.cos(turn), 0.2 * half_length * np.sin(turn)])
        across = np.array([-0.17 * half_width * np.sin(turn), 0.17 * half_width * np.cos(turn)])
        centre = np.array([at_x * half_length, at_y * half_width])
        corners = [
            centre + along + across,
            centre - along + across,
            centre - along - across,
            centre + along - across,
        ]
        pen.polygon(
            place([corner / (half_length, half_width) for corner in corners]), fill=COLOURS["tyre"]
        )
    pen.polygon(place(_BODY), fill=colour)
    for front, width in ((0.92, 0.72), (-0.9, 0.8)):
        pen.polygon(
            place(
                (
                    (front + 0.05, width),
                    (front - 0.05, width),
                    (front - 0.05, -width),
                    (front + 0.05, -width),
                )
            ),
            fill=colour,
        )
    pen.polygon(place(_COCKPIT), fill=COLOURS["tyre"])


def paint_names(
    image: Image.Image,
    camera: Camera,
    cars: np.ndarray,
    half_sizes: np.ndarray,
    names: Sequence[str],
    font: Any,
    top: float,
) -> None:
    """Write the policy's name next to each car, on the side away from the nearest car.

    Names stay inside the frame, ``top`` pixels below its upper edge. ``image`` is the reduced
    picture.
    """
    pen = ImageDraw.Draw(image)
    places = camera.pixels(cars[:, :2]) / FINER
    for car, name in enumerate(names[: len(cars)]):
        others = np.delete(places, car, axis=0)
        ways = places[car] - others
        apart = ways[np.argmin(np.hypot(*ways.T))] if len(others) else np.zeros(2)
        distance = float(np.hypot(*apart))
        # Cars at one place, or a single car: the first name above, the second name below.
        away = apart / distance if distance > 1.0 else np.array([0.0, 1.0 if car else -1.0])
        box = np.array(pen.textbbox((0, 0), name[:_NAME], font=font, stroke_width=_HALO))
        half = 0.5 * (box[2:] - box[:2])
        half_length = half_sizes[car, 0] * camera.scale / FINER
        gap = 4.0 + (_ARROW_SIZE * 1.7 if half_length < _MIN_CAR else _AHEAD[0][0] * half_length)
        # The box of the text, in this direction, ends a gap before the car.
        reach = gap + float(np.min(half / np.maximum(np.abs(away), 1e-6)))
        low = half + np.array([0.0, top])
        middle = np.clip(places[car] + away * reach, low, np.maximum(image.size - half, low))
        corner = middle - half - box[:2]
        pen.text(
            (float(corner[0]), float(corner[1])),
            name[:_NAME],
            fill=COLOURS[f"name{car}"],
            font=font,
            stroke_width=_HALO,
            stroke_fill=COLOURS["asphalt"],
        )


def _between(stops: Sequence[Colour], share: float) -> Colour:
    """Return the colour at a share from 0 to 1 of the way along some stops."""
    at = min(max(share, 0.0), 1.0) * (len(stops) - 1)
    i = min(int(at), len(stops) - 2)
    return tuple(round(a + (b - a) * (at - i)) for a, b in zip(stops[i], stops[i + 1], strict=True))


def _known(points: np.ndarray) -> np.ndarray:
    """Return the points of a path that are not NaN."""
    points = np.asarray(points)
    return points[~np.isnan(points[:, :2]).any(axis=1)]


def _flat(points: np.ndarray) -> list[float]:
    return [float(value) for value in np.asarray(points).ravel()]

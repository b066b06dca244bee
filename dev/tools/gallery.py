"""Write the GIFs of the gallery, the table of its scenes, scenes.csv, and the sheet of planners to
docs/images/gallery.

    python dev/tools/gallery.py

For each circuit of `CIRCUITS`, the races 0, 1, 2, ... of one seed are simulated in this order. The
first race that contains a scene of a kind gives its GIF; `SCENES` defines the kinds. The
page is made of the table whenever the site is built (``docs/site_pages.py``).
"""

import csv
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from pcs_racing import CONTEST, load_track, racer, record_race
from pcs_racing.base.files import write_atomically
from pcs_racing.planners.registry import get_planner, planner_names
from pcs_racing.race.config import Rules
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.replay import Replay
from pcs_racing_agents.watch.frames import replay_frames, write_gif

DOCS = Path(__file__).resolve().parents[2] / "docs"
FOLDER = "images/gallery"
TABLE = DOCS / FOLDER / "scenes.csv"

CIRCUITS = ("Tarnfjord", "Quillburg")
FAST, SLOW = "lattice:pace=0.95,overtaking=1", "lattice:pace=0.55"
SEED = 1
RACES = 300
MAX_GIF = 600_000  # bytes of a GIF
# For the sheet of planners: they begin 4 m behind a car with 0.6 of their speed.
BEHIND = Rules(
    start="rolling", start_gap=4.0, start_spacing=0.0, speed_range=(0.66, 1.1), steering_noise=0.01
)

BEFORE, AFTER = 4.0, 2.0  # s of a clip before and after its moment
CLOSE, DEFENDED = 2.0, 4.0  # m behind, and for how many s


def find_overtake(replay: Replay) -> float | None:
    """Return the moment of the first overtake with a new leader who leads for at least AFTER,
    or None.
    """
    lead = np.asarray(replay.lead)
    kept = round(AFTER / replay.frame_dt)
    for event in replay.events:
        at = round(event.time / replay.frame_dt)
        sign = 1.0 if event.car == 0 else -1.0
        after = sign * lead[at : at + kept]
        if (
            event.kind == "overtake"
            and event.time >= BEFORE
            and len(after) == kept
            and (after > 0.0).all()
        ):
            return float(event.time)
    return None


def find_defence(replay: Replay) -> float | None:
    """Return when one car has stayed less than CLOSE behind the other for DEFENDED without
    overtaking, or None.
    """
    lead = np.asarray(replay.lead)
    run = 0
    for i, value in enumerate(lead):
        # A change of the order ends it, and closer than 0.3 m the cars are side by side.
        same = i > 0 and value * lead[i - 1] > 0.0 and 0.3 < abs(value) < CLOSE
        run = run + 1 if same else 0
        if run * replay.frame_dt >= DEFENDED and i * replay.frame_dt >= BEFORE + AFTER:
            return i * replay.frame_dt
    return None


def find_crash(replay: Replay) -> float | None:
    """Return the moment of the first contact between the cars that has a guilty one, or None."""
    times = [
        event.time
        for event in replay.events
        if event.kind == "crash" and event.text.endswith("the other car")
    ]
    return float(times[0]) if times and times[0] >= BEFORE else None


class Scene(NamedTuple):
    """A kind of scene: its title, its rule, and the function that finds its moment in a race."""

    title: str
    rule: str
    find: Callable[[Replay], float | None]


SCENES = {
    "overtake": Scene(
        "Overtakes",
        f"A car passes the other one at least {BEFORE:.0f} s after the start, and leads for the"
        f" next {AFTER:.0f} s.",
        find_overtake,
    ),
    "defence": Scene(
        "Defences",
        f"For {DEFENDED:.0f} s one car is less than {CLOSE} m behind the other and does not pass.",
        find_defence,
    ),
    "crash": Scene(
        "Crashes",
        "The cars touch, and the rules find one of them at fault. The race ends with the contact.",
        find_crash,
    ),
}


HEAD = """# Gallery

A rule selects the scenes. On each circuit the races 0, 1, 2, ...
of seed {seed} are simulated under the rules of the rules `contest`, between
`{fast}` (fast, blue) and `{slow}` (slow, orange).
The first race with a scene of a kind gives its GIF. It plays at the speed of the race, and its
clock begins with the clip. The arrow, or the mark ahead of a car, shows which way the car drives.
"""

END = """## Make your own

`pcs-racing view` shows, filters and plays the races of a tournament or a study ([watch
races](../view.md)).
`pcs_racing_agents.watch.frames.write_gif` writes a recorded race as a GIF ([a
notebook](../notebooks/first_race.md) does it). Replays to play in the browser:
[Tarnfjord](https://pcs-racing.github.io/pcs-racing/replays/Tarnfjord.html),
[Quillburg](https://pcs-racing.github.io/pcs-racing/replays/Quillburg.html)."""


class Clip(NamedTuple):
    """A scene that was found: kind, circuit, number of the race, moment in s, and how the race
    ended.
    """

    kind: str
    circuit: str
    race: int
    time: float
    outcome: str

    @property
    def path(self) -> str:
        """Path of its GIF below ``docs``."""
        return f"{FOLDER}/{self.kind}-{self.circuit.lower()}.gif"


def find_clips(circuit: str) -> list[tuple[Clip, Replay]]:
    """Return the first scene of each kind on a circuit, with the race that it is taken from."""
    track, planners = load_track(circuit), (racer(FAST), racer(SLOW))
    found: dict[str, tuple[Clip, Replay]] = {}
    for race in range(RACES):
        replay = record_race(track, *planners, CONTEST, seed=SEED, index=race, candidates=False)
        for kind in SCENES.keys() - found.keys():
            time = SCENES[kind].find(replay)
            if time is not None:
                outcome = replay.outcome.replace(FAST, "fast").replace(SLOW, "slow")
                found[kind] = (
                    Clip(kind, circuit, race, time, outcome),
                    replace(replay, car_names=("fast", "slow")),
                )
        if len(found) == len(SCENES):
            break
    missing = SCENES.keys() - found.keys()
    if missing:
        raise SystemExit(f"gallery: no {', '.join(sorted(missing))} in {RACES} races on {circuit}")
    return [found[kind] for kind in SCENES]


def cut(replay: Replay, time: float) -> Replay:
    """Return the part of a race around a moment, without its plans."""
    first = max(0, round((time - BEFORE) / replay.frame_dt))
    last = round((time + AFTER) / replay.frame_dt) + 1
    return replace(
        replay,
        cars=replay.cars[first:last],
        progress=replay.progress[first:last],
        ittc=None,
        paths=None,
        candidates=None,
        costs=None,
        events=(),
    )


def planners_sheet() -> Image.Image:
    """Each planner and its plan where it comes nearest to a slower car in front, in the first race
    that it passes in.
    """
    names, (width, height), columns = sorted(planner_names()), (400, 280), 3
    sheet = Image.new("RGB", (columns * width, -(-len(names) // columns) * height), "white")
    track, slow = load_track(CIRCUITS[0]), racer("pure-pursuit:pace=0,follow_distance=0")
    for k, name in enumerate(names):
        planner = get_planner(name)
        fast = planner.policy({key: 1.0 for key in planner.parameter_names if key == "pace"})
        races = [
            record_race(track, fast, slow, BEHIND, seed=SEED, index=race) for race in range(10)
        ]
        behind = [race for race in races if race.lead[0] < 0.0]
        replay = replace(next(filter(find_overtake, behind), behind[0]), car_names=(name, "slower"))
        lead = np.asarray(replay.lead)
        time = float(np.argmax(np.where(lead < 0.0, lead, -np.inf))) * replay.frame_dt
        frames = list(
            replay_frames(
                replay, Renderer(replay, width, height, view="both"), fps=10.0, candidates=True
            )
        )
        sheet.paste(
            Image.fromarray(frames[int(10.0 * time)]), (k % columns * width, k // columns * height)
        )
    return sheet.quantize(128, dither=Image.Dither.NONE)


def scenes() -> list[Clip]:
    """Return the scenes of the table."""
    with open(TABLE, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [
        Clip(row["kind"], row["circuit"], int(row["race"]), float(row["time"]), row["outcome"])
        for row in rows
    ]


def write_scenes(clips: list[Clip]) -> None:
    """Write the table of the scenes."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Clip._fields)
    writer.writerows(clip._replace(time=f"{clip.time:.1f}") for clip in clips)
    write_atomically(TABLE, text.getvalue())


def gallery_page() -> str:
    """Return the page."""
    clips = scenes()
    blocks = [HEAD.format(seed=SEED, fast=FAST, slow=SLOW).strip()]
    for kind, scene in SCENES.items():
        blocks += [f"## {scene.title}", scene.rule]
        for clip in (clip for clip in clips if clip.kind == kind):
            blocks += [
                f"![{kind.capitalize()} on {clip.circuit}, seen from above](../{clip.path})",
                (
                    f"{clip.circuit}, race {clip.race}, around {clip.time:.1f} s. How the race"
                    f" ended: {clip.outcome}."
                ),
            ]
    blocks.append(END.strip())
    return "\n\n".join(blocks) + "\n"


def main() -> None:
    """Find the scenes, and write the GIFs and their table."""
    (DOCS / FOLDER).mkdir(parents=True, exist_ok=True)
    clips = []
    for circuit in CIRCUITS:
        for clip, replay in find_clips(circuit):
            scene = cut(replay, clip.time)
            path = write_gif(
                scene,
                DOCS / clip.path,
                renderer=Renderer(scene, 420, 300, view="both"),
                fps=10.0,
                speed=1.0,
            )
            size = path.stat().st_size
            print(f"{path}: race {clip.race}, {clip.time:.1f} s, {size:,} bytes", flush=True)
            if size > MAX_GIF:
                raise SystemExit(
                    f"gallery: {path.name} has {size:,} bytes; at most {MAX_GIF:,} are allowed"
                )
            clips.append(clip)
    write_scenes(clips)
    print(TABLE)
    planners_sheet().save(DOCS / FOLDER / "planners.png", optimize=True)


if __name__ == "__main__":
    main()

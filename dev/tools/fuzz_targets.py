"""What is fuzzed: every loader and every input of the environments, each as a function of bytes.

Loaders of files get the bytes as the file's content. Where a file carries a digest of another, the
digest is made to fit, or nothing but the digest would be tested. What takes values gets values that
are drawn from the bytes. Classes of settings and environments are found by what they declare: a new
one is fuzzed without a line here.
"""

import hashlib
import io
import json
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fuzz_inputs import Draw
from PIL import Image

from pcs_racing import (
    RaceGame,
    load_game_config,
    load_race_config,
    load_track,
    parse_policy,
    read_replay,
)
from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.files import plain_yaml, unpack_arrays
from pcs_racing.base.settings import Settings, load_settings
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.envs.match import MatchEnv, MatchVectorEnv
from pcs_racing.envs.opponents import parse_opponents
from pcs_racing.f1tenth.env import GenerationA, GenerationB
from pcs_racing.game.archive_files import ARCHIVE_FORMAT, load_archive
from pcs_racing.planners.field.lidar_networks import LIDAR_FORMAT, read_lidar_driver
from pcs_racing.planners.trained import DRIVER_FORMAT, read_driver
from pcs_racing.race.recording import record_race
from pcs_racing.race.replay import save_replay
from pcs_racing.track.map_files import (
    CENTERLINE_COLUMNS,
    RACELINE_COLUMNS,
    parse_csv,
    parse_grid,
    parse_info,
    parse_ros_yaml,
)
from pcs_racing.track.maps import find_map, find_shipped, read_map
from pcs_racing_agents.agents.fits import load_fit, shipped_fits
from pcs_racing_agents.agents.game_spec import make_game_spec
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.base.chunks import chunk_file, read_chunk, write_chunk
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.benchmark.card import board_page, read_card, read_cards, write_card
from pcs_racing_agents.learning.ppo.evaluation import EVALUATION_COLUMNS, read_evaluations
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.psro import load_psro_settings
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network
from pcs_racing_agents.networks.settings import load_train_settings
from pcs_racing_agents.policies.config import load_archive_config
from pcs_racing_agents.study.config import load_study_config
from pcs_racing_agents.study.report import read_curves
from pcs_racing_agents.study.results import open_results
from pcs_racing_agents.study.table import make_table
from pcs_racing_agents.tournament.play import plan_tournament, tournament_settings
from pcs_racing_agents.tournament.race_files import read_results
from pcs_racing_agents.trees import build_trees, load_trees
from pcs_racing_agents.watch.view_page import packed_races

BOARD = Path(__file__).resolve().parents[1] / "benchmarks" / "bench_v2"
Read = Callable[[Path], object]
Seeds = Callable[[], list[bytes]]


@dataclass(frozen=True)
class Target:
    """Something that must stand any bytes."""

    run: Callable[[bytes], object]  #: ``run(data)`` returns if they are accepted.
    seeds: Seeds  #: Returns valid inputs, which changes begin with.
    #: "text" or "yaml" or "json" or "csv" or "binary" or "npz" or "values": which changes make
    #: sense.
    kind: str
    most: int = 1_000_000  #: Inputs of a campaign at most, for slow ones.
    plain: bool = False  #: Whether all numbers of what is accepted must be finite and real.


@cache
def scratch() -> Path:
    """A folder for files, in memory where there is such a place."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="pcs-fuzz-", dir=memory if memory.is_dir() else None))


@cache
def small_game() -> RaceGame:
    track, archive = load_track("Tarnfjord"), load_archive("default")
    return RaceGame(track, archive, load_game_config("paper", moves=1, step_seconds=0.5))


# Ways to hand bytes to a function


def as_file(read: Read, name: str) -> Callable[[bytes], object]:
    """Give bytes to a loader as a file."""

    def run(data: bytes) -> object:
        path = scratch() / name
        path.write_bytes(data)
        return read(path)

    return run


def in_folder(folder: Callable[[], Path], name: str, read: Read) -> Callable[[bytes], object]:
    """Put them into a copy of a sound folder in the place of one of its files."""

    def run(data: bytes) -> object:
        place = _copied(folder(), name)
        (place / name).write_bytes(data)
        return read(place)

    return run


@cache
def _copied(folder: Path, name: str) -> Path:
    # One copy for each fuzzed file: the others in it stay sound.
    place = scratch() / f"{folder.name}-with-{name}"
    place.mkdir(exist_ok=True)
    for file in filter(Path.is_file, folder.iterdir()):
        (place / file.name).write_bytes(file.read_bytes())
    return place


def as_text(read: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: read(data.decode("utf-8", "surrogateescape"))


def signed(path: Path, data: bytes) -> None:
    """Write a chunk whose digests fit whatever it holds."""
    task = "0" * 64
    path.write_bytes(
        data
        + b"pcs-racing chunk "
        + task.encode()
        + hashlib.sha256(data + task.encode()).hexdigest().encode()
    )


def unsigned(path: Path) -> bytes:
    return path.read_bytes()[: -len(b"pcs-racing chunk ") - 128]


def texts(*values: str) -> Seeds:
    return lambda: [value.encode() for value in values]


def files(pattern: str, folder: Path) -> Seeds:
    return lambda: [path.read_bytes() for path in sorted(folder.glob(pattern))[:6]]


def values(size: int) -> Seeds:
    return lambda: [bytes(range(k, k + size)) for k in range(0, 250 - size, 13)]


def saved(save: Callable[[Path], object], name: str) -> Seeds:
    def seeds() -> list[bytes]:
        save(scratch() / name)
        return [(scratch() / name).read_bytes()]

    return seeds


# Settings: files of them, and every declared class


CONFIGS: dict[str, Read] = {
    "archive": load_archive_config,
    "ppo": load_ppo_settings,
    "psro": load_psro_settings,
    "race": load_race_config,
    "response": load_response_settings,
    "self-play": load_self_play_settings,
    "study": load_study_config,
    "train": load_train_settings,
}
NOT_SHIPPED = {
    "psro": b"rounds: 3\nraces: 20\n",
    "race": b"preset: contest\nduration: 16.0\nspeed_range: [0.5, 0.9]\nstart: rolling\n",
}


def config_seeds(kind: str) -> list[bytes]:
    return [path.read_bytes() for path in shipped_configs(kind).values()] or [NOT_SHIPPED[kind]]


def settings_classes(base: type[Settings] = Settings) -> Iterator[type[Settings]]:
    """Yield the declared classes of settings that are no base of others and whose fields all have a
    default.
    """
    for cls in base.__subclasses__():
        yield from settings_classes(cls)
        complete = all(
            one.default is not MISSING or one.default_factory is not MISSING for one in fields(cls)
        )
        if complete and not cls.__subclasses__():
            yield cls


def settings_of(cls: type[Settings], data: bytes) -> object:
    default = cls()
    changes = Draw(data).keywords({one.name: (getattr(default, one.name),) for one in fields(cls)})
    return load_settings("fuzzed", default, None, **changes)


# Artifacts: a manifest, and data whose digest stands in it

ARTIFACTS: dict[str, tuple[ArtifactFormat, Read]] = {
    "archive": (ARCHIVE_FORMAT, load_archive),
    "network": (NETWORK_FORMAT, load_network),
    "driver": (DRIVER_FORMAT, read_driver),
    "lidar driver": (LIDAR_FORMAT, read_lidar_driver),
}


def artifact(kind: str) -> Path:
    form = ARTIFACTS[kind][0]
    files = sorted(form.shipped.glob("*/manifest.yaml"))  # several kinds may share a folder
    return next(
        file.parent
        for file in files
        if f"pcs-racing {form.noun}\n" in file.read_text(encoding="utf-8")
    )


def artifact_data(kind: str, data: bytes) -> object:
    """Fuzz the file whose digest stands in a manifest; the digest is made to fit."""
    form, read = ARTIFACTS[kind]
    place = _copied(artifact(kind), form.data_file)
    (place / form.data_file).write_bytes(data)
    text = (artifact(kind) / "manifest.yaml").read_text(encoding="utf-8")
    # The digest is replaced in the text rather than in the mapping, so that all else stays byte for
    # byte.
    old = yaml.safe_load(text)[form.digest_key]
    (place / "manifest.yaml").write_text(
        text.replace(old, hashlib.sha256(data).hexdigest()), encoding="utf-8"
    )
    return read(place)


# Chunks and trees


@cache
def trees() -> tuple[Path, bytes, bytes]:
    """A folder of trees, its manifest and its first chunk."""
    folder = scratch() / "trees"
    build_trees(small_game(), folder, pairs=1, seed=0)
    return folder, (folder / "job.yaml").read_bytes(), unsigned(chunk_file(folder, "tree", 0))


def read_trees(manifest: bool, data: bytes) -> object:
    folder, sound, chunk = trees()
    (folder / "job.yaml").write_bytes(data if manifest else sound)
    # Both files are written every time: the other target may have left broken ones in the same
    # folder.
    signed(chunk_file(folder, "tree", 0), chunk if manifest else data)
    stored = load_trees(folder)
    return (
        stored.check(small_game()),
        stored[0].observations(0),
        stored[0].game_tree(),
        stored[0].statistics,
    )


@cache
def chunk_seed() -> bytes:
    path = scratch() / "seed.npz"
    write_chunk(
        path, {"lead": np.arange(6.0).reshape(2, 3), "names": np.array(["a", "bc"])}, fingerprint(1)
    )
    return unsigned(path)


def signed_chunk(data: bytes) -> object:
    signed(scratch() / "signed.npz", data)
    return read_chunk(scratch() / "signed.npz")


JOB = {"seed": 1, "names": ["a", "b"], "rules": {"moves": 4}}


def job(folder: Path) -> object:
    with open_job(folder, "fuzzed", JOB) as opened:
        return opened


@cache
def job_folder() -> Path:
    job(scratch() / "job")
    return scratch() / "job"


# Score cards


@cache
def card_folder() -> Path:
    """Two cards that a leaderboard shows, with the scores over all opponents."""
    for name in ("never-switch", "response"):
        values = json.loads((BOARD / name / "card.json").read_text())
        values["scores"] = [score for score in values["scores"] if score["part"] == "all"]
        (scratch() / "cards" / name).mkdir(parents=True, exist_ok=True)
        (scratch() / "cards" / name / "card.json").write_text(json.dumps(values))
    return scratch() / "cards"


def card(data: bytes) -> object:
    """Read a card, show it beside a sound one, and read back what is written of it."""
    file = card_folder() / "response" / "card.json"
    file.write_bytes(data)
    read = read_card(file)
    write_card(read, scratch())
    if read_card(scratch() / "card.json") != read:
        raise AssertionError("a card reads back as another one")
    return read, board_page(read_cards([card_folder()]))


# Maps

MAP = Path("fuzzed")
ROS = {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.25}


@cache
def small_map() -> Path:
    """A ring of 60 x 60 cells as a map folder."""
    folder = scratch() / "Ring"
    folder.mkdir(exist_ok=True)
    y, x = np.meshgrid(*(2 * [0.2 * (np.arange(60) + 0.5) - 6.0]), indexing="ij")
    away = np.hypot(x, y)
    Image.fromarray(np.where((away > 2.2) & (away < 5.0), 255, 0).astype(np.uint8)).save(
        folder / "Ring_map.png"
    )
    ros = "image: Ring_map.png\nresolution: 0.2\norigin: [-6.0, -6.0, 0.0]\nnegate: 0\n"
    (folder / "Ring_map.yaml").write_text(ros + "occupied_thresh: 0.45\nfree_thresh: 0.196\n")
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    rows = np.column_stack([3.6 * np.cos(turn), 3.6 * np.sin(turn), np.full((60, 2), 1.3)])
    np.savetxt(folder / "Ring_centerline.csv", rows, "%.4f", ", ")
    turn = np.append(turn, 2.0 * np.pi)
    zero = np.zeros(61)
    line = [
        3.6 * turn,
        3.6 * np.cos(turn),
        3.6 * np.sin(turn),
        turn + np.pi / 2,
        zero + 1 / 3.6,
        zero + 5,
        zero,
    ]
    np.savetxt(folder / "Ring_raceline.csv", np.column_stack(line), "%.4f", "; ")
    known = (
        "{speed_range: [0.5, 1.0], start_spacing: 0.9, start_places: {left: [[1.0, 3.0]]},"
        " left_share: 0.5}"
    )
    (folder / "Ring_track.yaml").write_text(
        f"description: a ring\ncalibration:\n  paper: {known}\n"
    )
    return folder


def ring(name: str) -> Seeds:
    return lambda: [(small_map() / name).read_bytes()]


def built(name: str) -> Callable[[bytes], object]:
    """Build a track of a map of which one file is fuzzed."""
    return in_folder(
        small_map, name, lambda folder: load_track(find_map(folder / "Ring_map.yaml").yaml)
    )


def pictures() -> list[bytes]:
    grey = Image.fromarray((np.arange(144).reshape(12, 12) % 256).astype(np.uint8))
    found = []
    for kind, mode in (
        *(("PNG", mode) for mode in ("L", "1", "RGB", "P", "LA")),
        ("BMP", "L"),
        ("PPM", "L"),
    ):
        buffer = io.BytesIO()
        grey.convert(mode).save(buffer, kind)
        found.append(buffer.getvalue())
    return found


# Results

RESULTS = (
    "ego,opponent,track,race,start_s,side,seed,lead,winner,crash,fault,ego_overtakes,opponent_overtakes,duration,"
    "ego_variant,opponent_variant,ego_path,opponent_path,ego_moves,opponent_moves\n"
)
for race, ending in enumerate(
    ("0,0,1.5,ego,none,none,1,0,40.0", "1,0,-1.5,none,wall,ego,1,0,12.0") * 2
):
    ego, other = 3 + race // 2, 4 + race // 2
    moves = f"{ego},{other},{ego}; 5,{other}; {other},restraint +,stay"
    RESULTS += f"never-switch,random-moves,Pipkin,{race},12.5,{ending},{moves}\n"
CURVE = (
    ",".join(EVALUATION_COLUMNS)
    + "\n0,100,paper,paper"
    + ",1" * (len(EVALUATION_COLUMNS) - 4)
    + "\n"
)


@cache
def tournament_folder() -> Path:
    plan = plan_tournament(
        [load_track("Pipkin")], ["never-switch", "random-moves"], races_per_pair=2
    )
    folder = scratch() / "tournament"
    with open_job(folder, "tournament", tournament_settings(plan)):
        (folder / "results.csv").write_text(RESULTS)
    return folder


def first_pairing(folder: Path) -> object:
    results = open_results(folder)
    return results.pairing(results.row(0))


@cache
def replay(name: str) -> bytes:
    car = parse_policy("lattice")
    made = record_race(load_track("Tarnfjord"), car, car, load_race_config("paper", duration=0.3))
    return saved(lambda path: save_replay(made, path), name)()[0]


# Environments

ENVS: dict[str, tuple[type[Any], dict[str, Any]]] = {
    "drive": (DriveEnv, {"opponent": "pure-pursuit"}),
    "drives": (DriveVectorEnv, {"opponent": None, "num_envs": 3, "threads": 1}),
    "two drives": (DriveHeadToHeadEnv, {}),
    "duel": (DuelEnv, {"moves": 2, "step_seconds": 0.1}),
    "duels": (DuelVectorEnv, {"moves": 2, "step_seconds": 0.1, "num_envs": 2, "threads": 1}),
    "two duels": (HeadToHeadEnv, {"moves": 2, "step_seconds": 0.1}),
    "match": (MatchEnv, {"races": 2}),
    "matches": (MatchVectorEnv, {"races": 2, "num_envs": 2, "threads": 1}),
}


@cache
def environment(name: str) -> Any:
    cls, arguments = ENVS[name]
    return cls(track="Pipkin", **arguments)


def sound_action(env: Any) -> Any:
    if hasattr(env, "possible_agents"):
        return {agent: env.action_space(agent).sample() for agent in env.possible_agents}
    return env.action_space.sample()


def inputs(name: str, data: bytes) -> object:
    """Seeds, options, states and actions of an environment."""
    draw, env = Draw(data), environment(name)
    what = draw.byte() % 6
    if what < 2:
        policies = {"policies": [draw.value(0, 1), draw.value(2)]}
        seed = draw.value(0, None, [1, 2, 3], [None, 1])
        return env.reset(seed=seed, options=draw.value(None, {}, policies, {"start": draw.value()}))
    env.reset(seed=0)
    if what == 2 and hasattr(env, "set_state"):
        return env.set_state(draw.value(env.get_state()))
    sound = sound_action(env)
    if isinstance(sound, dict):
        return env.step(
            draw.value(
                sound, {agent: draw.value(action) for agent, action in sound.items()}, {"car_0": 0}
            )
        )
    # Numbers too large for 32 bits become infinite, with a warning of numpy's that is ours and not
    # the environment's.
    with np.errstate(all="ignore"):
        odd = (
            np.array([draw.number() for _ in range(np.size(sound))])
            .reshape(np.shape(sound))
            .astype(np.float32)
        )
    return env.step(
        draw.value(sound, odd, odd.tolist(), np.float64(sound), [[1], [1]], np.array(2), -1, 4)
    )


def made(name: str, data: bytes) -> object:
    """Environments made of odd arguments, and a first step in them."""
    draw = Draw(data)
    cls, arguments = ENVS[name]
    likely = dict(cls.declared.defaults)
    if cls.declared.more is not None:
        likely |= {one.name: one.default for one in fields(cls.declared.more)}
    likely |= arguments
    given = {
        "track": "Pipkin",
        **arguments,
        **draw.keywords({key: (value,) for key, value in likely.items()}),
    }
    env = cls(**given)
    env.reset(seed=1)
    result = env.step(sound_action(env))
    env.close()
    return result


OLD_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "seed": (1,),
    "num_agents": (1, 2, 3),
    "timestep": (0.01, 0.02),
    "ego_idx": (0, 1),
    "params": ({"mu": 0.8}, {}),
}
OLD_CONFIG: dict[str, tuple[Any, ...]] = {
    "integrator": ("rk4", "euler"),
    "model": ("st", "ks", "mb"),
    "control_input": ("speed", ["accl", "steering_speed"]),
    "observation_config": (
        {"type": "original"},
        {"type": "features", "features": ["scan", "collision"]},
    ),
    "reset_config": ({"type": "cl_random_random"}, {"type": "rl_grid_static", "min_dist": 2.0}),
}


def old_program(generation: str, data: bytes) -> object:
    """A program of the F1TENTH gym: an environment of odd arguments, and odd calls of it."""
    draw, env = Draw(data), None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what is not known is named in a warning
        if generation == "a":
            arguments = draw.keywords({**OLD_ARGUMENTS, "map_ext": (".png",), "lidar_dist": (0.2,)})
            env = GenerationA(**{"map": "Pipkin", "faithful": draw.byte() % 2 > 0, **arguments})
        else:
            config = {"map": "Pipkin", **draw.keywords({**OLD_ARGUMENTS, **OLD_CONFIG})}
            env = GenerationB(
                draw.value(config, config), faithful=draw.byte() % 2 > 0, render_mode="rgb_array"
            )
        poses = np.array([[0.5 * i, 0.0, 1.0] for i in range(env.num_agents)])
        for _ in range(1 + draw.byte() % 6):
            what = draw.byte() % 8
            if what < 2 or not env.sim.started:
                odd = draw.value(poses, poses, poses.tolist())
                (
                    env.reset(odd)
                    if generation == "a"
                    else env.reset(seed=1, options=draw.value(None, {"poses": odd}))
                )
            elif what < 5:
                with np.errstate(all="ignore"):
                    env.step(draw.value(env.action_space.sample(), env.action_space.sample()))
            elif what == 5:
                env.update_params(
                    draw.value({"mu": 1.0}, {"width": draw.number()}), draw.value(0, -1)
                )
            elif what == 6:
                env.add_render_callback(lambda renderer: renderer.cars)
            else:
                env.render("rgb_array")
    return env


def opponents(data: bytes) -> object:
    draw = Draw(data)
    names = (
        "never-switch",
        "random-moves",
        "always-restraint+",
        "lattice:pace=0.9",
        "lane-switcher:3",
    )
    mixed = [(1, names[0]), (draw.number(), names[1])]
    return parse_opponents(draw.value(*names, mixed, [draw.value(*names)]), small_game())


POLICIES = (
    "lattice",
    "lattice:pace=0.8,side_margin=0.2",
    "lane-switcher:3",
    "pure-pursuit",
    "gap-follower",
)
AGENTS = (
    *(
        *POLICIES,
        "never-switch",
        "random-moves",
        "always-restraint+",
        "best-fixed",
        "best-schedule:fit=x.yaml",
    ),
    *("cfr-argmax", "cfr-argmax:network=default-paper-regret", "random-policy"),
    "adaptive:margin=0.1",
)


@cache
def spec() -> Any:
    return make_game_spec()


TARGETS: dict[str, Target] = {
    "map yaml": Target(lambda data: parse_ros_yaml(MAP, data), ring("Ring_map.yaml"), "yaml"),
    "map info yaml": Target(
        lambda data: parse_info(MAP, data),
        files("*/*_track.yaml", find_shipped("Pipkin").parent),
        "yaml",
    ),
    "map picture": Target(lambda data: parse_grid(MAP, data, ROS), pictures, "binary"),
    "map centre line": Target(
        lambda data: parse_csv(MAP, data, CENTERLINE_COLUMNS, ","),
        ring("Ring_centerline.csv"),
        "csv",
    ),
    "map race line": Target(
        lambda data: parse_csv(MAP, data, RACELINE_COLUMNS, ";"), ring("Ring_raceline.csv"), "csv"
    ),
    "map folder": Target(
        in_folder(small_map, "Ring_map.yaml", lambda folder: read_map(folder / "Ring_map.yaml")),
        ring("Ring_map.yaml"),
        "yaml",
    ),
    "track of a yaml": Target(built("Ring_map.yaml"), ring("Ring_map.yaml"), "yaml", 3000),
    "track of a centre line": Target(
        built("Ring_centerline.csv"), ring("Ring_centerline.csv"), "csv", 3000
    ),
    "track of a race line": Target(
        built("Ring_raceline.csv"), ring("Ring_raceline.csv"), "csv", 3000
    ),
    "track of a picture": Target(built("Ring_map.png"), ring("Ring_map.png"), "binary", 3000),
    "track name": Target(
        as_text(load_track), texts("Pipkin", "tarnfjord", "./x", "maps/Pipkin"), "text"
    ),
    "archive name": Target(
        as_text(load_archive), texts("default", "contest", "archives/default"), "text"
    ),
    "policy text": Target(as_text(parse_policy), texts(*POLICIES), "text"),
    "agent text": Target(as_text(lambda text: parse_agent(text, spec())), texts(*AGENTS), "text"),
    "opponents": Target(opponents, values(40), "values"),
    "f110 program": Target(partial(old_program, "a"), values(120), "values"),
    "f1tenth program": Target(partial(old_program, "b"), values(120), "values"),
    "yaml": Target(plain_yaml, files("*.yaml", shipped_fits()), "yaml"),
    "arrays": Target(unpack_arrays, lambda: [chunk_seed()], "npz"),
    "chunk": Target(
        as_file(read_chunk, "chunk.npz"),
        lambda: [chunk_seed(), (scratch() / "seed.npz").read_bytes()],
        "binary",
    ),
    "chunk, signed": Target(signed_chunk, lambda: [chunk_seed()], "npz"),
    "tree manifest": Target(partial(read_trees, True), lambda: [trees()[1]], "yaml"),
    "tree chunk, signed": Target(partial(read_trees, False), lambda: [trees()[2]], "npz"),
    "job manifest": Target(
        in_folder(job_folder, "job.yaml", job),
        lambda: [(job_folder() / "job.yaml").read_bytes()],
        "yaml",
    ),
    "replay json": Target(as_file(read_replay, "race.json"), lambda: [replay("seed.json")], "json"),
    "replay page": Target(
        as_file(read_replay, "race.html"), lambda: [replay("seed.html")], "binary"
    ),
    "fit": Target(
        as_file(load_fit, "fit.yaml"), files("*.yaml", shipped_fits()), "yaml", plain=True
    ),
    "card": Target(
        card,
        lambda: [file.read_bytes() for file in card_folder().glob("response/*")],
        "json",
        plain=True,
    ),
    "results table": Target(
        in_folder(
            tournament_folder, "results.csv", lambda folder: make_table(open_results(folder).races)
        ),
        texts(RESULTS),
        "csv",
    ),
    "results in the viewer": Target(
        as_file(lambda path: packed_races(read_results(path)), "viewed.csv"), texts(RESULTS), "csv"
    ),
    "results manifest": Target(
        in_folder(tournament_folder, "job.yaml", first_pairing),
        lambda: [(tournament_folder() / "job.yaml").read_bytes()],
        "yaml",
    ),
    "loss table": Target(
        as_file(read_curves, "curve.csv"),
        texts("epoch,training_loss,validation_loss\n0,1.5,2\n1,1,2\n"),
        "csv",
    ),
    "ppo curve": Target(as_file(read_evaluations, "ppo.csv"), texts(CURVE), "csv"),
}
for kind, load in CONFIGS.items():
    TARGETS[f"{kind} config"] = Target(
        as_file(load, f"{kind}.yaml"), partial(config_seeds, kind), "yaml", plain=True
    )
for kind, (form, load) in ARTIFACTS.items():
    for file in ("manifest.yaml", form.data_file):
        kind_of_file = {".yaml": "yaml", ".npz": "npz"}.get(Path(file).suffix, "binary")
        run = (
            partial(artifact_data, kind)
            if file == form.data_file
            else in_folder(partial(artifact, kind), file, load)
        )
        seeds = partial(lambda kind, file: [(artifact(kind) / file).read_bytes()], kind, file)
        TARGETS[f"{kind} {Path(file).stem}"] = Target(run, seeds, kind_of_file, plain=True)
for cls in settings_classes():
    TARGETS[f"values of {cls.__name__}"] = Target(partial(settings_of, cls), values(40), "values")
for name in ENVS:
    TARGETS[f"{name}: arguments"] = Target(partial(made, name), values(40), "values")
    TARGETS[f"{name}: inputs"] = Target(partial(inputs, name), values(60), "values")

"""What is fuzzed: every loader and every input of the environments, each as a function of bytes.

A target takes any bytes, and either accepts them or raises an error of :mod:`pcs_racing.base.errors`. Loaders of files get
the bytes as the file's content; where a file carries a digest of another, the digest is made to fit, or nothing but the
digest would be tested. What takes values (options, actions, seeds) gets values that are drawn from the bytes.
"""

import hashlib
import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fuzz_environments import (
    drive_envs,
    drive_inputs,
    drive_options,
    duel_envs,
    duel_inputs,
    game_options,
    head_to_head_inputs,
    opponents,
    race_options,
    small_game,
)
from PIL import Image

from pcs_racing import load_race_config, load_state, load_track, parse_policy, read_replay
from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.reading import plain_yaml, unpack_arrays
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive_files import ARCHIVE_FORMAT, load_archive
from pcs_racing.game.state import load_game, save_game
from pcs_racing.planners.trained import read_driver, save_driver
from pcs_racing.race.recording import record_race
from pcs_racing.race.replay_files import save_replay
from pcs_racing.race.state import empty_state, save_state
from pcs_racing.track.map_files import (
    CENTERLINE_COLUMNS,
    RACELINE_COLUMNS,
    parse_csv,
    parse_grid,
    parse_info,
    parse_ros_yaml,
)
from pcs_racing.track.maps import find_map, read_map, shipped_folder
from pcs_racing_agents.agents.fits import load_fit, shipped_fits
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import parse_agent
from pcs_racing_agents.jobs.chunks import chunk_file, read_chunk, write_chunk
from pcs_racing_agents.jobs.configuration import shipped_configs
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.learning.ppo.evaluation import EVALUATION_COLUMNS, read_evaluations
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.learning.robust import load_psro_settings, load_robust_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.from_ego import ego_values
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network
from pcs_racing_agents.networks.settings import load_train_settings
from pcs_racing_agents.results.race_files import read_results
from pcs_racing_agents.study.config import load_study_config
from pcs_racing_agents.study.report_inputs import read_curves, read_losses
from pcs_racing_agents.study.table import make_table
from pcs_racing_agents.synthesis.config import load_archive_config
from pcs_racing_agents.tournament.play import plan_tournament, tournament_settings
from pcs_racing_agents.trees import build_ego_trees, build_trees, load_ego_trees, load_trees
from pcs_racing_agents.view.results_folder import open_results
from pcs_racing_agents.view.view_page import packed_races

MAP = Path("fuzzed")
ROS = {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.25}


@dataclass(frozen=True)
class Target:
    """Something that must stand any bytes."""

    run: Callable[[bytes], object]  #: ``run(data)`` returns if they are accepted.
    seeds: Callable[[], list[bytes]]  #: Returns valid inputs, which mutations begin with.
    kind: str  #: "text" or "yaml" or "json" or "csv" or "binary" or "npz" or "values": What mutations make sense.
    words: tuple[str, ...] = ()  #: Names and values to put in.
    most: int = 1_000_000  #: Inputs of a campaign at most, for slow ones.


@cache
def scratch() -> Path:
    """A folder for files, in memory where there is such a place."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="pcs-fuzz-", dir=memory if memory.is_dir() else None))


def as_file(read: Callable[[Path], object], name: str) -> Callable[[bytes], object]:
    """Give bytes to a loader as a file."""

    def run(data: bytes) -> object:
        path = scratch() / name
        path.write_bytes(data)
        return read(path)

    return run


def files(pattern: str, folder: Path) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(folder.glob(pattern))[:6]]


# Folders whose manifest carries a digest of the other file


def manifest_of(folder: Callable[[], Path], name: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
    """Fuzz the manifest of a folder whose other files are sound."""

    def run(data: bytes) -> object:
        place = _copied(folder(), f"{name}-of")
        (place / name).write_bytes(data)
        return read(place)

    return run


def content_of(
    folder: Callable[[], Path], manifest: str, name: str, key: str, read: Callable[[Path], object]
) -> Callable[[bytes], object]:
    """Fuzz the file whose digest stands in a manifest; the digest is made to fit."""

    def run(data: bytes) -> object:
        place = _copied(folder(), f"{name}-in")
        (place / name).write_bytes(data)
        text, old = _manifest_text(folder() / manifest, key)
        (place / manifest).write_text(text.replace(old, hashlib.sha256(data).hexdigest()), encoding="utf-8")
        return read(place)

    return run


@cache
def _manifest_text(path: Path, key: str) -> tuple[str, str]:
    text = path.read_text(encoding="utf-8")
    return text, yaml.safe_load(text)[key]


@cache
def _copied(folder: Path, name: str) -> Path:
    place = scratch() / f"{folder.name}-{name}"
    place.mkdir(exist_ok=True)
    for file in folder.iterdir():
        if file.is_file():
            (place / file.name).write_bytes(file.read_bytes())
    return place


def default_archive() -> Path:
    return ARCHIVE_FORMAT.shipped / "default"


def some_network() -> Path:
    return sorted(NETWORK_FORMAT.shipped.glob("*/manifest.yaml"))[0].parent


@cache
def some_driver() -> Path:
    rng = np.random.default_rng(0)
    from pcs_racing.planners.network import INPUTS

    sizes = (len(INPUTS), 4, 2)
    layers = DenseLayers(
        tuple(rng.normal(size=(sizes[i + 1], sizes[i])).astype(np.float32) for i in range(2)),
        tuple(np.zeros(sizes[i + 1], np.float32) for i in range(2)),
    )
    return save_driver(scratch() / "driver", layers, name="fuzzed", hold=4, training={"steps": 1})


# Chunks and trees


def damaged_chunk(data: bytes) -> object:
    return as_file(read_chunk, "chunk.npz")(data)


def signed_chunk(data: bytes) -> object:
    """A chunk whose digests fit whatever it holds."""
    return _read_signed(data, scratch() / "signed.npz", read_chunk)


def _read_signed(data: bytes, path: Path, read: Callable[[Path], object]) -> object:
    body, task = data, "0" * 64
    mark = b"pcs-racing chunk "
    digest = hashlib.sha256(body + task.encode()).hexdigest()
    path.write_bytes(body + mark + task.encode() + digest.encode())
    return read(path)


def _unsigned(path: Path) -> bytes:
    return path.read_bytes()[: -len(b"pcs-racing chunk ") - 128]


@cache
def some_trees() -> Path:
    folder = scratch() / "trees"
    build_trees(small_game(), folder, pairs=1, seed=0)
    return folder


def tree_manifest(data: bytes) -> object:
    (some_trees() / "job.yaml").write_bytes(data)
    trees = load_trees(some_trees())
    return trees[0], trees.check(small_game())


@cache
def _tree_manifest() -> bytes:
    return (some_trees() / "job.yaml").read_bytes()


def tree_chunk(data: bytes) -> object:
    (some_trees() / "job.yaml").write_bytes(_tree_manifest())
    tree = _read_signed(data, chunk_file(some_trees(), "tree", 0), lambda path: load_trees(some_trees())[0])
    return tree.observations(0), tree.game_tree(), tree.statistics  # type: ignore[attr-defined]


def _tree_chunk() -> bytes:
    _tree_manifest()
    return _unsigned(chunk_file(some_trees(), "tree", 0))


@cache
def some_ego_trees() -> Path:
    folder = scratch() / "ego-trees"
    build_ego_trees(small_game(), folder, roots=2, seed=0)
    return folder


@cache
def _ego_manifest() -> bytes:
    return (some_ego_trees() / "job.yaml").read_bytes()


def ego_manifest(data: bytes) -> object:
    (some_ego_trees() / "job.yaml").write_bytes(data)
    return load_ego_trees(some_ego_trees())


def ego_chunk(data: bytes) -> object:
    (some_ego_trees() / "job.yaml").write_bytes(_ego_manifest())
    trees = _read_signed(data, chunk_file(some_ego_trees(), "ego", 0), lambda path: load_ego_trees(some_ego_trees()))
    return [trees.observations(k) for k in range(trees.moves)], ego_values(trees)  # type: ignore[attr-defined]


def _ego_chunk() -> bytes:
    _ego_manifest()
    return _unsigned(chunk_file(some_ego_trees(), "ego", 0))


def _chunk() -> bytes:
    path = scratch() / "seed.npz"
    write_chunk(path, {"lead": np.arange(6.0).reshape(2, 3), "names": np.array(["a", "bc"])}, fingerprint(1))
    return _unsigned(path)


def job_folder(data: bytes) -> object:
    folder = scratch() / "job"
    folder.mkdir(exist_ok=True)
    (folder / "job.yaml").write_bytes(data)
    with open_job(folder, "fuzzed", {"seed": 1, "names": ["a", "b"], "rules": {"moves": 4}}) as job:
        return job


def _job() -> bytes:
    folder = scratch() / "job-seed"
    with open_job(folder, "fuzzed", {"seed": 1, "names": ["a", "b"], "rules": {"moves": 4}}):
        return (folder / "job.yaml").read_bytes()


# Maps


@cache
def small_map() -> Path:
    """A ring of 60 x 60 cells as a map folder."""
    folder = scratch() / "Ring"
    folder.mkdir(exist_ok=True)
    y, x = np.meshgrid(*(2 * [0.2 * (np.arange(60) + 0.5) - 6.0]), indexing="ij")
    away = np.hypot(x, y)
    Image.fromarray(np.where((away > 2.2) & (away < 5.0), 255, 0).astype(np.uint8)).save(folder / "Ring_map.png")
    ros = "image: Ring_map.png\nresolution: 0.2\norigin: [-6.0, -6.0, 0.0]\nnegate: 0\n"
    (folder / "Ring_map.yaml").write_text(ros + "occupied_thresh: 0.45\nfree_thresh: 0.196\n")
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    rows = np.column_stack([3.6 * np.cos(turn), 3.6 * np.sin(turn), np.full((60, 2), 1.3)])
    np.savetxt(folder / "Ring_centerline.csv", rows, "%.4f", ", ")
    turn = np.append(turn, 2.0 * np.pi)
    zero = np.zeros(61)
    line = [3.6 * turn, 3.6 * np.cos(turn), 3.6 * np.sin(turn), turn + np.pi / 2, zero + 1 / 3.6, zero + 5, zero]
    np.savetxt(folder / "Ring_raceline.csv", np.column_stack(line), "%.4f", "; ")
    known = "{speed_range: [0.5, 1.0], start_spacing: 0.9, start_places: {left: [[1.0, 3.0]]}, left_share: 0.5}"
    (folder / "Ring_track.yaml").write_text(f"description: a ring\ncalibration:\n  paper: {known}\n")
    return folder


def map_file(name: str, build: bool) -> Callable[[bytes], object]:
    """Fuzz one file of a map; with ``build``, the track is built of it."""

    def run(data: bytes) -> object:
        place = _copied(small_map(), name)
        (place / name).write_bytes(data)
        if not build:
            return read_map(place / "Ring_map.yaml")
        return load_track(find_map(place / "Ring_map.yaml").yaml)

    return run


def map_seed(name: str) -> Callable[[], list[bytes]]:
    return lambda: [(small_map() / name).read_bytes()]


def pictures() -> list[bytes]:
    grey = Image.fromarray((np.arange(144).reshape(12, 12) % 256).astype(np.uint8))
    found = []
    for kind, mode in (
        ("PNG", "L"),
        ("PNG", "1"),
        ("PNG", "RGB"),
        ("PNG", "P"),
        ("PNG", "LA"),
        ("BMP", "L"),
        ("PPM", "L"),
    ):
        buffer = io.BytesIO()
        grey.convert(mode).save(buffer, kind)
        found.append(buffer.getvalue())
    return found


# States and replays


def _saved(save: Callable[[Path], object], name: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        save(scratch() / name)
        return [(scratch() / name).read_bytes()]

    return seeds


@cache
def some_replay() -> Any:
    car = parse_policy("lattice")
    return record_race(load_track("Tarnfjord"), car, car, load_race_config("paper", duration=0.3))


def replay_json(data: bytes) -> object:
    return as_file(read_replay, "race.json")(data)


# Texts


@cache
def setting() -> Setting:
    return make_setting()


def text_of(read: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: read(data.decode("utf-8", "surrogateescape"))


POLICIES = (
    "lattice",
    "lattice:pace=0.8",
    "lattice:pace=0.8,side_margin=0.2",
    "lane-switcher:3",
    "pure-pursuit",
    "gap-follower",
)
AGENTS = (
    *POLICIES, "never-switch", "random-moves", "always-aggressiveness+", "best-fixed", "best-schedule:fit=x.yaml",
    "cfr-argmax", "cfr-argmax:network=default-paper-regret", "receding-horizon:depth=2", "random-policy", "adaptive:margin=0.1",
)  # fmt: skip


def texts(*values: str) -> Callable[[], list[bytes]]:
    return lambda: [value.encode() for value in values]


def values(size: int) -> Callable[[], list[bytes]]:
    return lambda: [bytes(range(k, k + size)) for k in range(0, 250 - size, 13)]


# Tables

RESULTS = (
    "ego,opponent,track,race,start_s,side,seed,lead,winner,crash,fault,ego_overtakes,opponent_overtakes,duration,"
    "ego_variant,opponent_variant,ego_path,opponent_path,ego_moves,opponent_moves\n"
    "never-switch,random-moves,Pipkin,0,12.5,0,0,1.5,ego,,,1,0,40.0,3,4,3 5,4 4,restraint +,stay\n"
    "never-switch,random-moves,Pipkin,1,12.5,1,0,-1.5,,wall,ego,1,0,12.0,3,4,3 5,4 4,restraint +,stay\n"
)


@cache
def tournament_folder() -> Path:
    plan = plan_tournament([load_track("Pipkin")], ["never-switch", "random-moves"], races_per_pair=2)
    folder = scratch() / "tournament"
    with open_job(folder, "tournament", tournament_settings(plan)):
        (folder / "results.csv").write_text(RESULTS)
    return folder


@cache
def results_manifests() -> list[bytes]:
    folder = scratch() / "study"
    with open_job(folder, "study", plain_settings(load_study_config("quick"))):
        pass
    return [(place / "job.yaml").read_bytes() for place in (tournament_folder(), folder)]


def results_manifest(data: bytes) -> object:
    folder = _copied(tournament_folder(), "manifest")
    (folder / "job.yaml").write_bytes(data)
    results = open_results(folder)
    return results.pairing(results.row(0))


def results_table(data: bytes) -> object:
    folder = _copied(tournament_folder(), "table")
    (folder / "results.csv").write_bytes(data)
    return make_table(open_results(folder).races)


def viewed_table(data: bytes) -> object:
    file = scratch() / "viewed.csv"
    file.write_bytes(data)
    return packed_races(read_results(file))


CURVE = (
    ",".join(EVALUATION_COLUMNS)
    + "\n"
    + ",".join(["0", "100", *("paper" for _ in range(2)), *("1" for _ in range(len(EVALUATION_COLUMNS) - 4))])
    + "\n"
)


def configs(kind: str) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in shipped_configs(kind).values()]


TARGETS: dict[str, Target] = {
    "map yaml": Target(lambda data: parse_ros_yaml(MAP, data), map_seed("Ring_map.yaml"), "yaml"),
    "map info yaml": Target(lambda data: parse_info(MAP, data), files("*/*_track.yaml", shipped_folder()), "yaml"),
    "map picture": Target(lambda data: parse_grid(MAP, data, ROS), pictures, "binary"),
    "map centre line": Target(
        lambda data: parse_csv(MAP, data, CENTERLINE_COLUMNS, ","), map_seed("Ring_centerline.csv"), "csv"
    ),
    "map race line": Target(
        lambda data: parse_csv(MAP, data, RACELINE_COLUMNS, ";"), map_seed("Ring_raceline.csv"), "csv"
    ),
    "map folder": Target(
        map_file("Ring_map.yaml", False), map_seed("Ring_map.yaml"), "yaml", ("../Ring_map.png", "/etc/passwd")
    ),
    "track of a yaml": Target(map_file("Ring_map.yaml", True), map_seed("Ring_map.yaml"), "yaml", most=3000),
    "track of a centre line": Target(
        map_file("Ring_centerline.csv", True), map_seed("Ring_centerline.csv"), "csv", most=3000
    ),
    "track of a race line": Target(
        map_file("Ring_raceline.csv", True), map_seed("Ring_raceline.csv"), "csv", most=3000
    ),
    "track of a picture": Target(map_file("Ring_map.png", True), map_seed("Ring_map.png"), "binary", most=3000),
    "track name": Target(text_of(load_track), texts("Pipkin", "tarnfjord", "./x", "maps/Pipkin"), "text"),
    "yaml": Target(
        plain_yaml,
        files("*.yaml", shipped_fits()),
        "yaml",
        ("&a", "*a", "<<:", "!!int", "!!timestamp", "!!python/name:os"),
    ),
    "arrays": Target(unpack_arrays, lambda: [_chunk()], "npz"),
    "archive manifest": Target(
        manifest_of(default_archive, "manifest.yaml", load_archive),
        files("*/manifest.yaml", ARCHIVE_FORMAT.shipped),
        "yaml",
    ),
    "archive arrays": Target(
        content_of(default_archive, "manifest.yaml", "archive.npz", "arrays_sha256", load_archive),
        files("default/archive.npz", ARCHIVE_FORMAT.shipped),
        "npz",
    ),
    "archive name": Target(text_of(load_archive), texts("default", "contest", "archives/default"), "text"),
    "network manifest": Target(
        manifest_of(some_network, "manifest.yaml", load_network),
        lambda: [(some_network() / "manifest.yaml").read_bytes()],
        "yaml",
    ),
    "network weights": Target(
        content_of(some_network, "manifest.yaml", "weights.safetensors", "weights_sha256", load_network),
        lambda: [(some_network() / "weights.safetensors").read_bytes()],
        "binary",
    ),
    "driver manifest": Target(
        manifest_of(some_driver, "manifest.yaml", read_driver),
        lambda: [(some_driver() / "manifest.yaml").read_bytes()],
        "yaml",
    ),
    "driver weights": Target(
        content_of(some_driver, "manifest.yaml", "weights.safetensors", "weights_sha256", read_driver),
        lambda: [(some_driver() / "weights.safetensors").read_bytes()],
        "binary",
    ),
    "chunk": Target(damaged_chunk, lambda: [_chunk()], "binary"),
    "chunk, signed": Target(signed_chunk, lambda: [_chunk()], "npz"),
    "tree manifest": Target(tree_manifest, lambda: [_tree_manifest()], "yaml"),
    "tree chunk, signed": Target(tree_chunk, lambda: [_tree_chunk()], "npz"),
    "ego tree manifest": Target(ego_manifest, lambda: [_ego_manifest()], "yaml"),
    "ego tree chunk, signed": Target(ego_chunk, lambda: [_ego_chunk()], "npz"),
    "job manifest": Target(job_folder, lambda: [_job()], "yaml"),
    "race state": Target(
        as_file(load_state, "race.npz"),
        _saved(lambda path: save_state(empty_state(2, 3), path), "race-seed.npz"),
        "npz",
    ),
    "game state": Target(
        as_file(load_game, "game.npz"),
        _saved(lambda path: save_game(small_game().reset(games=2), path), "game-seed.npz"),
        "npz",
    ),
    "fit": Target(as_file(load_fit, "fit.yaml"), files("*.yaml", shipped_fits()), "yaml"),
    "race config": Target(
        as_file(load_race_config, "race.yaml"),
        texts("preset: contest\nduration: 16.0\nspeed_range: [0.5, 0.9]\nstart: rolling\n"),
        "yaml",
    ),
    "training config": Target(as_file(load_train_settings, "train.yaml"), configs("train"), "yaml"),
    "archive config": Target(as_file(load_archive_config, "archive.yaml"), configs("archive"), "yaml"),
    "study config": Target(as_file(load_study_config, "study.yaml"), configs("study"), "yaml"),
    "ppo config": Target(as_file(load_ppo_settings, "ppo.yaml"), configs("ppo"), "yaml"),
    "response config": Target(as_file(load_response_settings, "response.yaml"), configs("response"), "yaml"),
    "results table": Target(results_table, texts(RESULTS), "csv"),
    "results in the viewer": Target(viewed_table, texts(RESULTS), "csv"),
    "results manifest": Target(results_manifest, results_manifests, "yaml"),
    "losses to best replies": Target(
        as_file(read_losses, "losses.csv"),
        texts(
            "agent,track,loss,low,high,races,reply_won,agent_won,agent_own_crash\n"
            "a,Pipkin,0.1,0,0.2,400,0.6,0.4,0.1\na,all,,nan,2,3,1,1,1\n"
        ),
        "csv",
    ),
    "robust config": Target(
        as_file(load_robust_settings, "robust.yaml"), texts("pool_share: 0.5\nrounds: 2\n"), "yaml"
    ),
    "psro config": Target(as_file(load_psro_settings, "psro.yaml"), texts("rounds: 3\nraces: 20\n"), "yaml"),
    "self-play config": Target(as_file(load_self_play_settings, "self-play.yaml"), configs("self-play"), "yaml"),
    "loss table": Target(
        as_file(read_curves, "curve.csv"), texts("epoch,training_loss,validation_loss\n0,1.5,2\n1,1,2\n"), "csv"
    ),
    "ppo curve": Target(as_file(read_evaluations, "ppo.csv"), texts(CURVE), "csv"),
    "replay json": Target(
        replay_json, lambda: [_saved(lambda path: save_replay(some_replay(), path), "seed.json")()[0]], "json"
    ),
    "replay page": Target(
        as_file(read_replay, "race.html"),
        lambda: [_saved(lambda path: save_replay(some_replay(), path), "seed.html")()[0]],
        "binary",
    ),
    "policy text": Target(
        text_of(parse_policy), texts(*POLICIES), "text", ("pace=", "side_margin", "nan", "1e999", "=", ",", ":")
    ),
    "agent text": Target(
        text_of(lambda text: parse_agent(text, setting())), texts(*AGENTS), "text", ("=", ",", ":", "[1]", "{a: 1}")
    ),
    "opponents": Target(opponents, values(40), "values"),
    "game options": Target(game_options, values(40), "values"),
    "race options": Target(race_options, values(40), "values"),
    "drive options": Target(drive_options, values(40), "values"),
    "drive environments": Target(drive_envs, values(40), "values"),
    "drive actions and seeds": Target(drive_inputs, values(60), "values"),
    "duel environments": Target(duel_envs, values(40), "values"),
    "duel actions and seeds": Target(duel_inputs, values(60), "values"),
    "head-to-head inputs": Target(head_to_head_inputs, values(60), "values"),
}

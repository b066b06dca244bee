"""One door: a text or an object names the same racer at every place that asks who drives.

A row of the table has one right answer, or one refusal: at places of policies (``run_races``,
``record_race``, ``race``, ``tune``) an agent is refused, since it plays a game; at places of a game
(environments, tournaments, ``make``) both race. Names of code run on the command line alone.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

import pcs_racing
import pcs_racing_agents
from pcs_racing import CONTEST, load_track, make_game, racer, run_races
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.duel import DuelEnv
from pcs_racing.planners.planner import Policy, PolicySet
from pcs_racing.planners.racers import policy_racer
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.agents import export_onnx
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.tournament import plan_tournament

sb3, torch, onnx = (pytest.importorskip(name) for name in ("stable_baselines3", "torch", "onnx"))

NETWORKS = "pcs_racing_agents/data/networks/"
PLANNER = "pcs_racing/data/planners/line-ppo"
OWN = """
from pcs_racing import racer

def own_policy():
    return racer("pure-pursuit")

def own_agent(spec):
    return racer("random-moves", spec)
"""

POLICIES = {
    "lattice": Policy,
    "lattice:pace=0.5": Policy,
    "lane-switcher:3": Policy,
    "lane-switcher:any": PolicySet,
    "default[3]": Policy,
    "drive.zip": Policy,
    "drive.onnx": Policy,
    "planner folder": Policy,
}
AGENTS = (
    "never-switch",
    "random-moves",
    "always-restraint+",
    "cfr-argmax",
    "cfr-regret-matching:decision=argmax",
    "duel.zip",
    "duel.onnx",
    "network folder",
)
CODE = ("mine.py:own_policy", "mine.py:own_agent")
REFUSED = {
    "latice": "did you mean 'lattice'",
    "lattice:fast": "no variant 'fast'",
    "lattice:pace=9": "must lie in",
    "cfr-argmax:speed=3": "has no option 'speed'",
    "always-jump": "'jump' is no move",
    "nowhere.zip": "can't read nowhere.zip",
    "archive folder": "is an archive of policies; name one",
    "default[999]": "policy index",
    "lattice:any": None,
}


@pytest.fixture(scope="module")
def game():
    return make_game("Tarnfjord")


@pytest.fixture(scope="module")
def models():
    drive = DriveEnv(track="Pipkin", opponent=None)
    duel = DuelEnv(track="Tarnfjord")
    small = {"n_steps": 4, "batch_size": 4, "device": "cpu", "seed": 0}
    return {
        "drive.zip": sb3.PPO("MlpPolicy", drive, **small),
        "duel.zip": sb3.PPO("MlpPolicy", duel, **small),
    }


@pytest.fixture(scope="module")
def text_of(models, tmp_path_factory):
    """Texts of the rows; files are in a folder of the test."""
    from repository import REPOSITORY

    place = tmp_path_factory.mktemp("racers")
    for name, model in models.items():
        model.save(place / name)
        export_onnx(place / name, (place / name).with_suffix(".onnx"))
    (place / "mine.py").write_text(OWN)
    folders = {
        "planner folder": str(REPOSITORY / PLANNER),
        "network folder": str(REPOSITORY / NETWORKS / "default-paper-regret"),
        "archive folder": str(REPOSITORY / "pcs_racing/data/archives/default"),
    }

    def text(row: str) -> str:
        file = place / row.partition(":")[0]
        return folders.get(row) or (str(place / row) if file.exists() else row)

    return text


def of_game(text, game):
    """Return the racer of a text at each place of a game."""
    plan = plan_tournament(game.track, [text, "stanley"], "paper", archive="default")
    return {
        "racer": racer(text, game),
        "Duel": DuelEnv(track=game.track, opponent=text).opponents[0].competitor,
        "mixture": DuelEnv(track=game.track, opponent=[(2.0, text)]).opponents[0].competitor,
        "Drive": DriveEnv(track=game.track, opponent=text).batch.opponents[0].competitor,
        "tournament": plan.competitors[0],
        "make": pcs_racing_agents.make(text),
    }


@pytest.mark.parametrize("row", [*POLICIES, *AGENTS])
def test_a_text_is_the_same_racer_at_all_places_of_a_game(row, text_of, game):
    text = text_of(row)
    found = of_game(text, game)
    digests = {
        competitor_hash(PolicySet("x", (one,)) if isinstance(one, Policy) else one)
        for one in found.values()
    }
    assert len(digests) == 1
    assert {one.name for one in found.values()} == {text}


@pytest.mark.parametrize("row", POLICIES)
def test_a_policy_races_at_places_without_a_game(row, text_of):
    text = text_of(row)
    assert isinstance(racer(text), POLICIES[row])
    if POLICIES[row] is PolicySet:
        refused("has 20 policies; name one of them", policy_racer, text)
        return
    track, short = load_track("Tarnfjord"), pcs_racing.load_rules(CONTEST, duration=1.0)
    ends = [
        run_races(track, one, "stanley", short).state.cars for one in (text, racer(text), [text])
    ]
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[0], ends[2])
    replay = pcs_racing.record_race(track, text, "stanley", short)
    assert replay.car_names[0] == text


@pytest.mark.parametrize("row", AGENTS)
def test_an_agent_is_refused_at_places_without_a_game(row, text_of, capsys):
    text, track = text_of(row), load_track("Tarnfjord")
    message = "is an agent, which moves between the policies of an archive"
    refused(message, racer, text)
    refused(message, run_races, track, text, "lattice")
    refused(message, run_races, track, "lattice", [text])
    refused(message, pcs_racing.record_race, track, "lattice", text)
    assert main(["race", "--ego", text]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("row", CODE)
def test_code_runs_on_the_command_line_alone(row, text_of, game, capsys):
    text = text_of(row)
    message = "names code, and no file may run code by a name"
    for call in (racer, pcs_racing_agents.make):
        refused(message, call, text)
    refused(message, run_races, game.track, text, "lattice")
    for env in (DriveEnv, DuelEnv):
        refused(message, env, opponent=text)
    made = racer(text, game, code=True)
    assert made.name == text
    assert main(["tournament", "--agents", text, "never-switch", "--races", "2"]) == 0
    assert text.rpartition("/")[2][-10:] in capsys.readouterr().out


@pytest.mark.parametrize("row", REFUSED)
def test_a_wrong_text_is_refused_alike_at_all_places(row, text_of, game):
    text = text_of(row)
    message = REFUSED[row] or "policies of"
    if REFUSED[row] is None:
        assert len(racer(text).policies) == len(get_planner("lattice").variants)
        return
    for call in (
        lambda: racer(text, game),
        lambda: DuelEnv(track=game.track, opponent=text),
        lambda: DriveEnv(track=game.track, opponent=text),
        lambda: plan_tournament(game.track, [text, "stanley"]),
        lambda: pcs_racing_agents.make(text),
    ):
        refused(message, call)


class Acts:
    name = "acts"
    content_hash = "acts"

    def act(self, observations, turn):
        return np.zeros(len(observations), int)


class Predicts:
    name = "predicts"
    content_hash = "predicts"

    def predict(self, observations, state=None, episode_start=None, deterministic=True):
        return np.zeros(len(observations), int), None


def draws(observation, generator):
    return 0


def steers(observations):
    return 0.0 * observations[:, :2]


def objects(models, game):
    drive, duel = models.values()
    return {
        "planner": (get_planner("pure-pursuit"), True),
        "policy": (racer("pure-pursuit"), True),
        "SB3 of Drive": (drive, True),
        "function of observations": (steers, True),
        "module with 2 outputs": (torch.nn.Linear(41, 2), True),
        "SB3 of Duel": (duel, False),
        "act": (Acts(), False),
        "predict": (Predicts(), False),
        "function with a generator": (draws, False),
        "module with 4 outputs": (torch.nn.Linear(31, 4), False),
    }


@pytest.mark.parametrize("row", list(objects({"a": None, "b": None}, None)))
def test_an_object_is_the_same_racer_at_all_places(row, models, game):
    given, drives = objects(models, game)[row]
    plan = plan_tournament(game.track, {"it": given, "stanley": "stanley"}, archive="default")
    found = [
        plan.competitors[0],
        DriveEnv(track=game.track, opponent=given).batch.opponents[0].competitor,
        racer(given, game, name="it"),
    ]
    assert found[0].name == found[2].name == "it"
    assert [isinstance(one, Policy | PolicySet) for one in found] == [drives] * 3
    if drives:
        short = pcs_racing.load_rules(CONTEST, duration=1.0)
        assert run_races(game.track, given, "stanley", short).state.tick[0] > 0
        return
    refused("is an agent, which moves", run_races, game.track, given, "lattice")
    env = DuelEnv(track=game.track, opponent=given, steps=(0.5,) * 5)
    env.reset(seed=1)
    *_, info = env.step(1)
    assert 0 <= info["opponent_move"] < 5


@pytest.mark.parametrize("wrong", [3, Acts, np.zeros(2), SimpleNamespace(), None])
def test_an_object_without_any_of_the_methods_is_refused(wrong, game):
    refused("can't race; give a text, a policy", racer, wrong, game)


def test_an_onnx_file_drives_and_moves_as_the_model(models, text_of, game):
    drive, duel = models.values()
    box = drive.observation_space
    low, high = np.clip(box.low, -1.0, 1.0), np.clip(box.high, -1.0, 1.0)
    rows = np.random.default_rng(0).uniform(low, high, (50, 41)).astype(np.float32)
    own, file = (racer(one).planner.drive for one in (drive, text_of("drive.onnx")))
    np.testing.assert_allclose(file.commands_of(rows), own.commands_of(rows), atol=1e-5)
    seen = rows[:, :31]
    agent = racer(text_of("duel.onnx"), game)
    np.testing.assert_array_equal(
        agent.model.predict(seen)[0], duel.predict(seen, deterministic=True)[0]
    )
    refused(
        "made for games of 4 moves",
        racer,
        text_of("duel.onnx"),
        make_game("Pipkin", steps=(8.0,) * 4),
    )

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_archive, load_track, run_races
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.view import OPP_V
from pcs_racing.testing import check_archive, check_planner

PACE = Parameter("pace", 0.0, 1.0, 0.5, "how fast")


@pytest.fixture(scope="module")
def track():
    return load_track("Pipkin")


def driver(drive, memory_size=0) -> Planner:
    return Planner("mine", (PACE,), drive=drive, memory_size=memory_size)


def test_a_sound_planner_passes_and_one_that_sees_too_far_or_stands_does_not(track):
    check_planner(get_planner("lattice"), track)
    check_planner(
        driver(lambda track, theta, view, memory: (0.0, 1.0 + theta[0])), track, seconds=0.8
    )

    def drive(track, theta, view, memory):
        return 0.0, 2.0 + 0.01 * view[OPP_V]

    check_planner(driver(drive), track, seconds=0.8)
    with pytest.raises(AssertionError, match="sight 5"):
        check_planner(Planner("mine", (PACE,), drive=drive, sight=5.0), track, seconds=0.8)
    with pytest.raises(AssertionError, match="stand still after 2 s"):
        check_planner(driver(lambda track, theta, view, memory: (0.0, 0.0)), track, seconds=2.0)


def keeps_a_secret():
    calls = [0]

    def drive(track, theta, view, memory):
        calls[0] += 1
        return 0.001 * (calls[0] % 7), 2.0

    return drive


def writes_to_theta(track, theta, view, memory):
    theta[0] = 0.0
    return 0.0, 2.0


def writes_beyond(track, theta, view, memory, scratch, path, command):
    memory[3] = 1.0
    command[0], command[1] = 0.0, 2.0


def fails_when_fast(track, theta, view, memory, scratch, path, command):
    if theta[0] == 1.0:
        raise ValueError("no road")
    command[0], command[1] = np.nan if theta[0] > 0.8 else 0.0, 2.0


def remembers_nonsense(track, theta, view, memory):
    memory[0] = np.nan
    return 0.0, 2.0


def test_a_compiled_planner_that_fails_is_named_with_race_and_car(track):
    sound, mine = get_planner("lattice").policy(), Planner("mine", (PACE,), control=fails_when_fast)
    for pace, said in (
        (1.0, "ValueError: no road"),
        (0.9, "FloatingPointError: its command is not finite"),
    ):
        slow, fast = mine.policy(), mine.policy({"pace": pace})
        refused(
            f"race 1, car 1: planner 'mine' raised {said}",
            run_races,
            track,
            [sound] * 2,
            [slow, fast],
            threads=1,
        )
        env = DriveEnv(track=track, opponent=fast)
        env.reset(seed=0)
        refused(
            f"race 0, car 1: planner 'mine' raised {said}",
            lambda env=env: [env.step([0.0, 0.0]) for _ in range(20)],
        )
    mute = Planner(
        "mute",
        (PACE,),
        control=lambda track, theta, view, memory, scratch, path, command: command.no(),
    )
    refused("a planner's '<lambda>' can't be compiled: ", run_races, track, mute.policy(), sound)


def test_the_checks_find_what_is_wrong_with_planners_and_archives(track):
    for planner, message in [
        (driver(keeps_a_secret()), "end differently"),
        (driver(remembers_nonsense, 1), "memory of race 0"),
        (
            Planner("mine", (PACE,), control=writes_beyond, memory_size=3),
            "writes beyond the end of an array",
        ),
    ]:
        refused(
            f"planner 'mine'.*{message}",
            check_planner,
            planner,
            track,
            seconds=0.8,
            error=AssertionError,
        )
    refused("read-only", check_planner, driver(writes_to_theta), track, error=AssertionError)
    check_archive(load_archive("default"))
    check_archive(load_archive("default"), track)
    refused(
        "planner 'nobody' is unknown", check_archive, change(planner="nobody"), error=AssertionError
    )
    refused(
        "no move leads",
        check_archive,
        change(ideal=np.full(2, 1e-6), nadir=np.zeros(2)),
        error=AssertionError,
    )
    with pytest.raises(AssertionError, match="parameter 'length' is 50"):
        check_archive(change(parameters=np.full_like(load_archive("default").parameters, 50.0)))


def change(**values) -> PolicyArchive:
    default = load_archive("default")
    return PolicyArchive(
        **{**{key: getattr(default, key) for key in default.__dataclass_fields__}, **values}
    )

"""The list of the stages of a study; a new stage is an entry here."""

from collections.abc import Callable
from typing import NamedTuple

from pcs_racing.base.checks import is_number
from pcs_racing.base.errors import InputError
from pcs_racing.base.optional import require
from pcs_racing.base.reading import parse_yaml
from pcs_racing_agents.learning.ppo.learner import check_packages
from pcs_racing_agents.study import playing, preparing, racing, reporting
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.synthesis.config import load_archive_config

DONE = "done.yaml"
"""File in the folder of a finished stage."""


def _report(study: Study) -> None:
    reporting.write_report(study, stage_seconds(study))


class Stage(NamedTuple):
    """A stage of a study; it works in a folder of its name."""

    name: str
    needs: tuple[str, ...]  #: Stages that must be done before.
    does: str  #: Its work, in a few words.
    run: Callable[[Study], None]  #: ``run(study)`` does the work, and skips what an earlier call has done.
    always: bool = False  #: Whether it runs again after it is done.

    def check_libraries(self, config: StudyConfig) -> None:
        """Raise ModuleNotFoundError if it needs a library that is missing."""
        learns = {
            "networks": config.pairs > 0,
            "responses": bool(config.responses),
            "self-play": config.self_play is not None or config.sampled_cfr is not None,
            "robust": config.robust is not None,
            "psro": config.psro is not None,
            "best-replies": bool(config.replies),
        }
        if learns.get(self.name):
            require("torch", extra="learning")
        elif self.name == "ppo" and config.ppo is not None:
            check_packages()
        elif self.name == "archive" and config.synthesis is not None:
            method = load_archive_config(config.synthesis).method
            require("moocore", *(("cma",) if method == "mo-cma-es" else ()), extra="synthesis")


LEARNED = ("networks", "blind", "responses", "robust", "psro", "self-play", "ppo")

STAGES = (
    Stage("archive", (), "searches policies", preparing.make_the_archive),
    Stage("trees", ("archive",), "plays game trees", preparing.play_trees),
    Stage("networks", ("trees",), "trains networks on the trees", preparing.train_networks),
    Stage("blind", ("archive",), "chooses the best agents that look at nothing but who leads", preparing.choose_blind),
    Stage("responses", ("networks", "blind"), "learns answers to opponents", preparing.learn_responses),
    Stage("self-play", ("archive",), "lets both cars learn", playing.play_against_itself),
    Stage("robust", ("blind",), "learns robust answers to opponents", playing.learn_robust_agent),
    Stage("psro", ("blind",), "learns answers to answers", playing.learn_psro_agent),
    Stage("ppo", ("archive",), "trains the PPO baseline", preparing.train_ppo_baseline),
    Stage("races", LEARNED, "drives the races of the table", racing.race_tables),
    Stage("ratings", LEARNED, "lets agents race all against all", racing.race_for_ratings),
    Stage("best-replies", LEARNED, "trains a best reply to each agent", playing.measure_replies),
    Stage("report", ("races", "ratings", "best-replies"), "writes results.csv and report.html", _report, always=True),
)
"""All stages, in the order in which they run."""


def stage_seconds(study: Study) -> dict[str, float]:
    """Return the time of each finished stage, s, including earlier runs that were stopped."""
    seconds = {}
    for stage in STAGES:
        file = study.folder / stage.name / DONE
        if file.is_file():
            note = parse_yaml(file, file.read_bytes())
            value = note.get("seconds") if isinstance(note, dict) else None
            if not is_number(value) or not 0.0 <= value < 1e9:
                raise InputError(f"{file} is damaged: seconds are {value!r:.80}; delete it, and the stage runs again")
            seconds[stage.name] = float(value)
    return seconds

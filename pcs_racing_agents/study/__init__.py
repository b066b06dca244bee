"""The paper's study in one command: archive, game trees, networks, agents, races, and a report, stage by stage."""

from pcs_racing_agents.study.config import StudyConfig, load_study_config
from pcs_racing_agents.study.run import STAGES, run_study

__all__ = ["STAGES", "StudyConfig", "load_study_config", "run_study"]

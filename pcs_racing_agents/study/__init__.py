"""The paper's study in stages: archive, game trees, networks, agents, races and a report."""

from pcs_racing_agents.study.config import StudyConfig, load_study_config
from pcs_racing_agents.study.run import STAGES, run_study
from pcs_racing_agents.study.study import Study

__all__ = ["STAGES", "Study", "StudyConfig", "load_study_config", "run_study"]

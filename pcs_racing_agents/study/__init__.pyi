from .config import StudyConfig as StudyConfig, load_study_config as load_study_config
from .run import run_study as run_study
from .study import Study as Study
from .table import make_table as make_table, table_text as table_text, write_table as write_table

__all__ = [
    "Study",
    "StudyConfig",
    "load_study_config",
    "make_table",
    "run_study",
    "table_text",
    "write_table",
]

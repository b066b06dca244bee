"""Which files ``tools/mutants.py`` puts faults into, and which tests are those of their module.

Golden trajectories are left out: they say that something has changed, not what is right. Tests that are fast enough as
plain Python (``NUMBA_DISABLE_JIT=1``) run that way, since a fault in a compiled file costs half a minute of compiling.
"""

from pathlib import Path
from typing import NamedTuple

PLAIN, COMPILED = "plain", "compiled"


class Module(NamedTuple):
    """A file's part of the package, and its tests by how they run, the most specific ones first."""

    area: str
    plain: tuple[str, ...]
    compiled: tuple[str, ...] = ()


def tests_of(file: str, mode: str) -> tuple[str, ...]:
    """Tests of a file's module that run in one of the two ways."""
    return MODULES[file].plain if mode == PLAIN else MODULES[file].compiled


def _modules(area: str, folder: str, lines: str) -> dict[str, Module]:
    """Make a part of the table from lines "files: plain tests; compiled tests", names without their beginnings."""
    table = {}
    for line in filter(None, (line.strip() for line in lines.splitlines())):
        files, tests = line.split(":")
        plain, _, compiled = tests.partition(";")
        for file in files.split():
            table[f"{folder}/{file}.py"] = Module(area, *(_paths(folder, names) for names in (plain, compiled)))
    return table


def _paths(folder: str, names: str) -> tuple[str, ...]:
    """Paths of tests; a name that begins with a slash counts from the folder of all tests, others from the module's."""
    paths = [Path(name if name.startswith("/") else f"/{folder}/{name}") for name in names.split()]
    return tuple(f"tests{path.with_name(f'test_{path.name}')}.py" for path in paths)


MODULES = {
    **_modules(
        "kernels",
        "pcs_racing/track",
        """
        grid: grid
        frenet: frenet
        building/splines: building/splines
        building/walls: building/walls
        """,
    ),
    **_modules(
        "kernels",
        "pcs_racing/car",
        """
        vehicle: vehicle
        collision: collision /pcs_racing/race/race_kernel
        ittc: ittc /pcs_racing/race/race_kernel
        lidar_kernel: lidar
        lanes: ; vehicle
        """,
    ),
    **_modules(
        "kernels",
        "pcs_racing/planners",
        """
        planner pursuit: planner /pcs_racing/race/race_state; /pcs_racing/race/race_kernel
        pure_pursuit: ; pure_pursuit
        gap_follower: ; gap_follower
        lattice: ; lattice
        lane_switcher: ; lane_switcher
        """,
    ),
    **_modules("kernels", "pcs_racing/race", "kernel contacts progress steering: race_kernel; race"),
    **_modules(
        "rules",
        "pcs_racing/race",
        """
        races: race_kernel; race
        config: race_config
        state: race_state race_kernel
        """,
    ),
    **_modules(
        "rules",
        "pcs_racing/game",
        """
        rules state observation: ; game
        reward: reward; game
        competitor: ; competitor game
        starting: starting; game
        config: game_config
        archive: archive
        moves: archive; game
        """,
    ),
    **_modules("base", "pcs_racing/base", "code_cache: ; code_cache\nreading: reading"),
    **_modules("characteristics", "pcs_racing/game", "characteristics: characteristics"),
    **_modules(
        "environments",
        "pcs_racing/envs",
        """
        drive_kernel: drive_kernel; drive
        drive_batch: drive_kernel; drive variety
        drive_courses: drive_kernel; moving_opponents drive
        drive: ; contract drive drive_head_to_head defaults
        moving_opponents: ; moving_opponents drive
        game_batch: game_batch; duel variety
        opponents: game_batch; duel drive /pcs_racing_agents/agents/opponents
        duel: ; contract duel head_to_head defaults
        scalar vector: ; contract vector
        arguments: ; defaults vector
        over_batch: ; contract vector drive duel
        reset_options: ; reset_options
        match: ; contract match defaults
        match_batch: ; match variety
        parallel: ; contract head_to_head drive_head_to_head
        """,
    ),
    **_modules(
        "solvers",
        "pcs_racing_agents/solvers",
        """
        cfr cfr_kernels: cfr
        compare: compare
        efg: efg
        evaluation: evaluation cfr
        backward_induction: backward_induction
        game_tree: game_tree cfr
        matrix_games: matrix_games
        openspiel: efg
        rational_games: matrix_games
        sequence_form: sequence_form evaluation
        """,
    ),
    **_modules(
        "synthesis",
        "pcs_racing_agents/synthesis",
        """
        diverse: diverse
        evaluate scenarios: ; evaluate
        indicators: indicators; /packaging
        selection: selection
        pareto_archive: pareto_archive
        mo_cma_es: mo_cma_es; synthesize
        optimisers search synthesize: ; synthesize
        archive_search: ; archive_run
        """,
    ),
    **_modules(
        "statistics",
        "pcs_racing_agents/payoffs",
        """
        headroom: headroom
        policy_pool: ; policy_pool
        """,
    ),
    **_modules(
        "statistics",
        "pcs_racing_agents/tournament",
        """
        ratings: ratings
        round_robin: meta_game; round_robin
        table: ; tournament_table
        statistics/clusters: statistics
        statistics/comparison: statistics
        """,
    ),
}

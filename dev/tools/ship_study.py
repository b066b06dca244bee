"""Copy the networks and fits of a finished study into the data of the package.

    pcs-racing study paper --out out/paper
    python dev/tools/ship_study.py paper out/paper .

The last argument is a checkout; networks go to ``pcs_racing_agents/data/networks``, fits to
``pcs_racing_agents/data/fits``. ``--ppo FOLDER`` and ``--psro FOLDER`` add the result of
``pcs-racing train ppo`` and of ``pcs-racing train psro`` to the study.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

from pcs_racing_agents.agents.blind import load_fit, save_fit
from pcs_racing_agents.networks import (
    load_network,
    load_network_set,
    save_network,
    save_network_set,
)
from pcs_racing_agents.study.config import load_study_config
from pcs_racing_agents.study.study import Study


def ship(study: Study, checkout: Path, **others: Path) -> list[Path]:
    """Copy a study's networks and fits to the folders of the zoo; return the written paths.

    ``others``: folders of networks from outside the study, by their kind in the zoo.
    """
    stem = f"{study.spec.archive.name}-{study.spec.rules.name}"
    data = checkout / "pcs_racing_agents" / "data"
    folders = {kind: study.network(kind) for kind in ("regret", "nash")}
    folders["self-play"] = study.network("sampled-cfr")
    if study.config.learning.responses:
        folders["response"] = study.network(study.config.learning.responses[0])
    folders |= others
    written = [
        _ship_network(folder, data / "networks" / f"{stem}-{kind}")
        for kind, folder in folders.items()
        if kind in others or folder.is_dir()
    ]
    (data / "fits").mkdir(exist_ok=True)
    for file in sorted(study.folder.glob("open-loop/best-*.yaml")):
        written.append(save_fit(load_fit(file), data / "fits" / f"{stem}-{file.name}"))
    return written


def _ship_network(source: Path, place: Path) -> Path:
    """Copy a network, with its learning curve if there is one, or a set of networks."""
    if (source / "set.yaml").is_file():
        return save_network_set(replace(load_network_set(source), name=place.name), place)
    save_network(replace(load_network(source), name=place.name), place)
    if (source / "curve.csv").is_file():
        shutil.copyfile(source / "curve.csv", place / "curve.csv")
    return place


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("config", help="configuration of the study")
    parser.add_argument("folder", type=Path, help="folder of the study")
    parser.add_argument("checkout", type=Path, help="folder that holds pcs_racing_agents")
    parser.add_argument("--archive", help="archive of the study, in place of the configuration's")
    parser.add_argument("--ppo", type=Path, help="folder 'agent' of 'pcs-racing train ppo'")
    parser.add_argument("--psro", type=Path, help="folder 'agent' of 'pcs-racing train psro'")
    given = parser.parse_args()
    others = {kind: place for kind in ("ppo", "psro") if (place := getattr(given, kind))}
    changes = {} if given.archive is None else {"archive": given.archive}
    config = load_study_config(given.config, **changes)
    for path in ship(Study(config, given.folder), given.checkout, **others):
        print(path)


if __name__ == "__main__":
    main()

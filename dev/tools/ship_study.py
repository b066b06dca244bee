"""From a finished study to what the package ships: its networks, and what was chosen on its
training races.

    pcs-racing study paper --out out/paper
    python dev/tools/ship_study.py paper out/paper .

The last argument is a checkout; networks go to ``pcs_racing_agents/data/networks``, choices to
``data/fits``.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

from pcs_racing_agents.agents.fits import load_fit, save_fit
from pcs_racing_agents.networks import load_network, save_network
from pcs_racing_agents.study.config import load_study_config
from pcs_racing_agents.study.study import Study


def ship(study: Study, checkout: Path) -> list[Path]:
    """Copy a study's networks and choices to where the zoo looks for them; return what was written.

    The first response is what the agent "adaptive" asks: its network is called ``gain`` there.
    """
    spec = study.spec
    stem = f"{spec.archive.name}-{spec.race}"
    data = checkout / "pcs_racing_agents" / "data"
    networks, written = data / "networks", []
    targets = dict.fromkeys((*study.config.learning.targets, "regret"))
    kinds = {target: target for target in targets if study.network(target).is_dir()}
    if study.config.learning.responses:
        kinds["gain"] = study.config.learning.responses[0]
    for kind, found in kinds.items():
        name = f"{stem}-{kind}"
        written.append(
            save_network(replace(load_network(study.network(found)), name=name), networks / name)
        )
    if study.config.learning.ppo is not None:
        name = f"{stem}-ppo"
        place = save_network(
            replace(load_network(study.network("ppo")), name=name), networks / name
        )
        shutil.copyfile(study.network("ppo") / "curve.csv", place / "curve.csv")
        written.append(place)
    folder = data / "fits"
    folder.mkdir(exist_ok=True)
    for file in sorted(study.folder.glob("open-loop/*.yaml")):
        if file.name != "done.yaml":
            written.append(save_fit(load_fit(file), folder / f"{stem}-{file.name}"))
    return written


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("config", help="of the study")
    parser.add_argument("folder", type=Path, help="of the study")
    parser.add_argument("checkout", type=Path, help="the folder that holds pcs_racing_agents")
    given = parser.parse_args()
    for path in ship(Study(load_study_config(given.config), given.folder), given.checkout):
        print(path)


if __name__ == "__main__":
    main()

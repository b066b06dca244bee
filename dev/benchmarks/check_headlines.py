"""Recompute the headline figures from the kept tables, by csv and scipy alone, and find each on its
pages.

    python dev/benchmarks/check_headlines.py

Nothing of the packages is used, so that a fault of their statistics can't hide here. Tables: the
seven studies in ``studies/five_archives``, and the races of the ratings and of the field by pair in
``dev/benchmarks/kept_races.csv``.
"""

import csv
import re
import sys
from pathlib import Path
from statistics import fmean, stdev

import numpy as np
from scipy.optimize import minimize
from scipy.stats import t as student

ROOT = Path(__file__).resolve().parents[2]
STUDIES = {
    "0": ("table-0", "table-10", "table-20"),
    **{name: (f"table-{name}",) for name in "1234"},
}
HELD_OUT = ("gap-follower", "stanley", "predictive-spliner", "frenet-sampling", "ppo-drive")
TRACKS = ("Brackwater", "Pipkin", "Tarnfjord", "Monza", "Spielberg")


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as opened:
        return list(csv.DictReader(opened))


def signed(value: float, digits: int = 3) -> str:
    return f"{value:+.{digits}f}".replace("0.", ".", 1)


def looking(opponents: tuple[str, ...], arm: str = "response-contest", base: str = "") -> str:
    """Return the gain of an arm over a baseline (by default that of the study), Student's t over
    archives.
    """
    means = []
    for studies in STUDIES.values():
        gains = []
        for study in studies:
            table = rows(ROOT / "studies" / "five_archives" / study / "table.csv")
            chosen = base or next(row["base"] for row in table if row["kind"] == "adaptivity gain")
            score = {
                (row["track"], row["opponent"], row["base"]): float(row["score_base"])
                for row in table
            }
            score |= {
                (row["track"], row["opponent"], row["arm"]): float(row["score"]) for row in table
            }
            pairs = [(track, opponent) for track in TRACKS for opponent in opponents]
            gains.append(fmean(score[*pair, arm] - score[*pair, chosen] for pair in pairs))
        means.append(fmean(gains))
    reach = student.ppf(0.975, len(means) - 1) * stdev(means) / len(means) ** 0.5
    return (
        f"{signed(fmean(means))} [{signed(fmean(means) - reach)}, {signed(fmean(means) + reach)}]"
    )


def table_of(name: str) -> dict[str, tuple[float, float, float]]:
    """Return rating (Bradley-Terry, ties of Davidson), score and share of own crashes by entrant of
    a kept table.
    """
    races = [
        row for row in rows(Path(__file__).with_name("kept_races.csv")) if row["table"] == name
    ]
    names = sorted({row[key] for row in races for key in ("first", "second")})
    first, second = (
        np.array([names.index(row[key]) for row in races]) for key in ("first", "second")
    )
    met, won, lost, tied, crash, crash_of_second = (
        np.array([float(row[key]) for row in races])
        for key in ("races", "won_first", "won_second", "tied", "crashed_first", "crashed_second")
    )

    def unlikely(x: np.ndarray) -> float:
        ahead, tie = x[first] - x[second], x[-1]
        each = np.log(np.exp(ahead / 2) + np.exp(-ahead / 2) + np.exp(tie))
        likely = (won - lost) * ahead / 2 + tied * tie - (won + lost + tied) * each
        # the prior has a standard deviation of 3
        return float((x[:-1] ** 2).sum() / 18.0 - likely.sum())

    fitted = minimize(
        unlikely, [*([0.0] * len(names)), -6.0], method="BFGS", options={"gtol": 1e-3}
    ).x[:-1]
    found = {}
    for i, one in enumerate(names):
        a, b = first == i, second == i
        count = met[a].sum() + met[b].sum()
        points = (won + tied / 2)[a].sum() + (lost + tied / 2)[b].sum()
        own = crash[a].sum() + crash_of_second[b].sum()
        found[one] = (400 / np.log(10) * (fitted[i] - fitted.mean()), points / count, own / count)
    return found


def headlines() -> list[tuple[str, str]]:
    """Return patterns of the headline figures, each with a page that prints it."""
    readme, study = "README.md", "docs/reports/study.md"
    found = [(re.escape(looking(HELD_OUT)), page) for page in (readme, study, "CHANGELOG.md")]
    others = [looking(HELD_OUT, base="best-lead-plan"), *map(looking, (HELD_OUT[:1], HELD_OUT[1:]))]
    others += [looking(some, "cfr-argmax") for some in (HELD_OUT, ("random-moves",))]
    found += [(re.escape(figure), study) for figure in others]
    for name, (rating, score, own) in table_of("ratings").items():
        row = (
            rf"\| `{re.escape(name)}` \| \{rating:+.0f} \[[^|]*\] \| {score:.3f} \| {100 * own:.1f}"
            r" % \|"
        )
        found.append((row.replace("| 0.", "| ."), study))
    return found


if __name__ == "__main__":
    missing = 0
    for figure, page in headlines():
        text = " ".join((ROOT / page).read_text(encoding="utf-8").replace("**", "").split())
        missing += not (stands := re.search(figure, text))
        print(f"{'stands' if stands else 'MISSING'}: {figure} on {page}")
    sys.exit(missing > 0)

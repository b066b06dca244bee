"""The results folder of a tournament or study, for repeating its races."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament import Pairing, RaceRow, RaceTable

MANIFEST = "job.yaml"


@dataclass(frozen=True, eq=False)
class ResultsFolder:
    """A folder of races (:func:`pcs_racing_agents.study.study.open_results`)."""

    folder: Path
    file: Path  #: File of the races.
    races: RaceTable
    start: str  #: Kind of start.
    make_pairing: Callable[[RaceRow], Pairing]  #: Function that draws the races of a row's pair.

    def row(self, number: int) -> RaceRow:
        """Return a line of the results, counted from 0."""
        if not 0 <= number < len(self.races):
            raise InputError(
                f"there is no race {number} in {self.folder}; it holds races 0 to"
                f" {len(self.races) - 1}"
            )
        return self.races[number]

    def check_lead(self, number: int, lead: float) -> None:
        """Check that a repeated race ended with the lead in the results, to four digits."""
        recorded = f"{self.row(number).lead:.4f}"
        if f"{lead:.4f}" != recorded:
            raise InputError(
                f"race {number} came out otherwise than in {self.folder}: a lead of {lead:.4f} m"
                f" instead of {recorded} m; it was driven by another version"
            )

    def pairing(self, row: RaceRow) -> Pairing:
        """Return the pairing of a line; ``row.race`` is the line's number in the pairing."""
        try:
            return self.make_pairing(row)
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{self.folder / MANIFEST} is damaged: {error!r}") from None

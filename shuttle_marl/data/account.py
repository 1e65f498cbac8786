"""The account of a stroke table: what was read, what was kept, and why the rest was not."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

DROP_REASONS: Final = {
    "repeated row": "The same stroke of the same player stands there twice.",
    "unreadable value": "A value that cannot be what it should be, in a published file.",
    "broken homography": "More than a fifth of the rows of the game put both players in one half.",
    "contact heights unreliable": "Those of the whole game contradict each other, or the shot types.",
    "broken rally": "Strokes are not numbered 1, 2, …, players do not alternate, or the rally's number is taken.",
    "unknown shot type": "Nearly always a serve that the camera missed; the rest of the rally is kept.",
    "serve type inside a rally": "A serve that is not the first stroke.",
    "first stroke is no serve": "A rally that starts with another shot type.",
    "contact height missing": "Above or below the net is not known.",
    "side of the court unknown": "No coordinate tells the striker's half, or they contradict the rest of the rally.",
    "landing missing": "No landing point, of a stroke that is no fault.",
    "landing on the striker's side": "A returned or winning stroke that seems to have landed in the striker's own half.",
}
"""Why a row can be dropped, in the order in which the reasons are tried."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Account:
    """Counts of a stroke table, totals after deduplication of matches.

    Attributes:
        matches: matches read.
        rallies, strokes: numbers before dropping.
        rallies_kept: rallies of which at least one stroke was kept.
        strokes_kept: rows of the table.
        dropped: rows dropped by reason, keys of :data:`DROP_REASONS`; reasons that never applied are left out.
        area_agreement: share of kept strokes with an in-court label whose label is the area computed from the
            coordinates; None where there are no labels.
    """

    matches: int
    rallies: int
    rallies_kept: int
    strokes: int
    strokes_kept: int
    dropped: dict[str, int]
    area_agreement: float | None

    def as_json(self) -> dict[str, Any]:
        """The account as plain values."""
        return {
            "matches": self.matches,
            "rallies": {"total": self.rallies, "kept": self.rallies_kept},
            "strokes": {"total": self.strokes, "kept": self.strokes_kept},
            "dropped": self.dropped,
            "area_agreement": self.area_agreement,
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Account":
        """Read what :meth:`as_json` gave.

        Raises:
            KeyError, TypeError: it is something else.
        """
        return cls(
            matches=values["matches"],
            rallies=values["rallies"]["total"],
            rallies_kept=values["rallies"]["kept"],
            strokes=values["strokes"]["total"],
            strokes_kept=values["strokes"]["kept"],
            dropped=dict(values["dropped"]),
            area_agreement=values["area_agreement"],
        )

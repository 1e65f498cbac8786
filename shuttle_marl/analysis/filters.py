"""Some rallies of a stroke table, by game, score, server and length."""

import dataclasses

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.summary import AnalysisError, rally_table


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyFilter:
    """Which rallies count; what is not given does not matter.

    Attributes:
        games: numbers of games, from 1.
        leading: least and most points of the player who leads before the rally, or of both at a draw.
        server: name of the server, as in the table.
        length: least and most number of strokes.
    """

    games: tuple[int, ...] = ()
    leading: tuple[int, int] | None = None
    server: str | None = None
    length: tuple[int, int] | None = None

    def of(self, strokes: pa.Table) -> pa.Table:
        """The strokes of these rallies.

        Args:
            strokes: of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.

        Raises:
            AnalysisError: no rally is left.
        """
        rallies = rally_table(strokes)
        first, length = (rallies[name].to_numpy() for name in ("first", "length"))
        kept = np.ones(len(rallies), np.bool_)
        if self.games:
            kept &= np.isin(rallies["game"].to_numpy(), self.games)
        if self.server is not None:
            kept &= rallies["server"].to_numpy(zero_copy_only=False) == self.server
        if self.length is not None:
            kept &= (length >= self.length[0]) & (length <= self.length[1])
        if self.leading is not None:
            # The table has the points after the rally; without a winner or points those before it are not known.
            players, winner = (
                table[name].to_numpy(zero_copy_only=False).astype(object)
                for table, name in ((strokes.take(pa.array(first)), "player"), (rallies, "winner"))
            )
            own, other = (
                strokes[name].to_numpy(zero_copy_only=False).astype(np.float64)[first] for name in ("points", "points_opponent")
            )
            won = winner == players
            leader = np.where(winner == None, np.nan, np.maximum(own - won, other - ~won))  # noqa: E711  an array of objects
            kept &= (leader >= self.leading[0]) & (leader <= self.leading[1])
        if not kept.any():
            raise AnalysisError(f"no rally of {len(rallies):,} is left by {self}; ask for less")
        return strokes.filter(pa.array(np.repeat(kept, np.diff([*first, strokes.num_rows]))))

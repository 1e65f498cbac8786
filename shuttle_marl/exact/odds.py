"""Chances of winning a rally serving and receiving, and what they make of a match."""

import dataclasses

from shuttle_marl.game.scoring import BWF, Rules, match_win_probability


@dataclasses.dataclass(frozen=True, kw_only=True)
class Odds:
    """How one player fares against another.

    Attributes:
        serving: chance to win a rally that the player serves.
        receiving: chance to win a rally that the opponent serves.
        error_bound: both are within this of the true chance.
    """

    serving: float
    receiving: float
    error_bound: float

    @property
    def rally(self) -> float:
        """Chance to win a rally when both serve equally often."""
        return (self.serving + self.receiving) / 2

    @property
    def value(self) -> float:
        """The same on the scale of rewards, from -1 to 1."""
        return self.serving + self.receiving - 1

    def match(self, rules: Rules = BWF, first_server: int | None = None) -> float:
        """Chance to win a match; ``first_server`` 0 is the player, 1 the opponent, None a draw by lot."""
        return float(match_win_probability(self.serving, self.receiving, first_server=first_server, rules=rules))

    def match_error_bound(self, rules: Rules = BWF) -> float:
        """:meth:`match` is within this of the truth: winning more rallies never hurts, so the ends of the interval bound it."""
        low, high = (
            match_win_probability(*(min(1.0, max(0.0, p + e)) for p in (self.serving, self.receiving)), rules=rules)
            for e in (-self.error_bound, self.error_bound)
        )
        middle = self.match(rules)
        return float(max(high - middle, middle - low))

"""From the rally to the match: the odds of a match, and when perfect play in every rally is perfect play in the match.

A match is a binary Markov game: each rally is won or lost, and what follows depends on that alone. If winning a rally never
lowers the probability of winning the match, at any score and whoever serves, then playing minimax in
every rally is minimax in the match (Walker, Wooders & Amir, Games and Economic Behavior 71, 2011). That is not self-evident,
because the winner of a rally serves next, and serving can be a disadvantage.
"""

import dataclasses

from shuttle_marl.game.scoring import BWF, Rules, match_win_probability, wins_game

Situation = tuple[int, int, int, int, int]
"""Games of players 0 and 1, their points, and who serves."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Odds:
    """Odds of one player against another.

    Attributes:
        serving: probability of winning a rally that the player serves.
        receiving: probability of winning a rally that the opponent serves.
        error_bound: both are within this of the true probability.
    """

    serving: float
    receiving: float
    error_bound: float

    @property
    def rally(self) -> float:
        """Probability of winning a rally when both serve equally often."""
        return (self.serving + self.receiving) / 2

    @property
    def value(self) -> float:
        """The same on the scale of rewards, from -1 to 1."""
        return self.serving + self.receiving - 1

    def match(self, rules: Rules = BWF, first_server: int | None = None) -> float:
        """Probability of winning a match; ``first_server`` 0 is the player, 1 the opponent, None drawn at random."""
        return float(match_win_probability(self.serving, self.receiving, first_server=first_server, rules=rules))

    def match_error_bound(self, rules: Rules = BWF) -> float:
        """:meth:`match` is within this of the truth: winning more rallies never hurts, so the ends of the interval bound it."""
        low, high = (
            match_win_probability(*(min(1.0, max(0.0, p + e)) for p in (self.serving, self.receiving)), rules=rules)
            for e in (-self.error_bound, self.error_bound)
        )
        middle = self.match(rules)
        return float(max(high - middle, middle - low))


def match_table(serving: float, receiving: float, rules: Rules = BWF) -> dict[Situation, tuple[float, float]]:
    """Probabilities that player 0 wins the match after winning and after losing the next rally, in every situation.

    Args:
        serving: probability that player 0 wins a rally that player 0 serves.
        receiving: probability that player 0 wins a rally that player 1 serves.
        rules: when a game and the match are won.
    """
    table: dict[Situation, tuple[float, float]] = {}

    def win_probability(games: tuple[int, int], points: tuple[int, int], server: int) -> float:
        own, other = games
        if wins_game(*points, rules):
            own, points = own + 1, (0, 0)
        elif wins_game(*points[::-1], rules):
            other, points = other + 1, (0, 0)
        if rules.games in (own, other):
            return float(own == rules.games)
        won, lost = table[(own, other, *points, server)]
        p = receiving if server else serving
        return lost + p * (won - lost)

    points_left = [(i, j) for i in range(rules.cap - 1, -1, -1) for j in range(rules.cap - 1, -1, -1)]
    games_left = [(a, b) for a in range(rules.games - 1, -1, -1) for b in range(rules.games - 1, -1, -1)]
    for games in games_left:
        for i, j in points_left:
            if not (wins_game(i, j, rules) or wins_game(j, i, rules)):
                after = (win_probability(games, (i + 1, j), 0), win_probability(games, (i, j + 1), 1))
                for server in (0, 1):
                    table[(*games, i, j, server)] = after
    return table


def least_gain(serving: float, receiving: float, rules: Rules = BWF) -> float:
    """Least gain in player 0's probability of winning the match from winning a rally, over all scores.

    Where this is not negative, rallies can be solved one by one: the condition of Walker, Wooders & Amir holds. What player
    0 gains player 1 loses, so it holds for both.
    """
    return min(won - lost for won, lost in match_table(serving, receiving, rules).values())

"""Match odds from rally odds, and the condition under which minimax play in every rally is minimax play in the match.

A match is a binary Markov game: the score after a rally depends only on its winner. If winning a rally never lowers the
probability of winning the match, at any score and with either server, then minimax play in every rally is minimax play in the
match (Walker, Wooders & Amir, Games and Economic Behavior 71, 2011). The condition is not trivial, because the winner of a rally
serves next, and serving can be a disadvantage.
"""

import dataclasses

from shuttle_marl.game.scoring import BWF, Rules, count_rally, match_win_probability, open_scores

Situation = tuple[int, int, int, int, int]  # games of players 0 and 1, their points, and the server


@dataclasses.dataclass(frozen=True, kw_only=True)
class Odds:
    """Odds of one player against another.

    Attributes:
        serving: probability of winning a rally that the player serves.
        receiving: probability of winning a rally that the opponent serves.
        error_bound: absolute error bound of both.
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
        """Expected reward, from -1 to 1."""
        return self.serving + self.receiving - 1

    def match(self, rules: Rules = BWF, first_server: int | None = None) -> float:
        """Probability of winning a match; ``first_server`` 0 is the player, 1 the opponent, None drawn at random."""
        return float(match_win_probability(self.serving, self.receiving, first_server=first_server, rules=rules))

    def match_error_bound(self) -> float:
        """Absolute error bound of :meth:`match`, which increases with both probabilities of a rally."""
        low, high = (
            match_win_probability(*(min(1.0, max(0.0, p + e)) for p in (self.serving, self.receiving)))
            for e in (-self.error_bound, self.error_bound)
        )
        middle = self.match()
        return float(max(high - middle, middle - low))


def match_table(serving: float, receiving: float, rules: Rules = BWF) -> dict[Situation, tuple[float, float]]:
    """Probabilities that player 0 wins the match after winning and after losing the next rally, in every situation.

    Args:
        serving, receiving: probability that player 0 wins a rally that player 0 or player 1 serves.
    """
    table: dict[Situation, tuple[float, float]] = {}

    def win_probability(games: tuple[int, int], points: tuple[int, int], winner: int) -> float:
        """Of player 0 after a rally."""
        score, won = [*points], [*games]
        counted = count_rally(points[winner], points[1 - winner], games[winner], rules)
        if counted.match_won:
            return float(winner == 0)
        score[winner], won[winner] = counted.points, counted.games
        if counted.game_won:
            score = [0, 0]
        if_won, if_lost = table[(won[0], won[1], score[0], score[1], winner)]
        p = receiving if winner else serving
        return if_lost + p * (if_won - if_lost)

    for games, points in open_scores(rules):
        after = (win_probability(games, points, 0), win_probability(games, points, 1))
        for server in (0, 1):
            table[(*games, *points, server)] = after
    return table


def least_gain(serving: float, receiving: float, rules: Rules = BWF) -> float:
    """Least gain in player 0's probability of winning the match from winning a rally, over all scores.

    If it is not negative, the condition of Walker, Wooders & Amir holds and rallies can be solved separately. The match is
    zero-sum, so this covers both players.
    """
    return min(won - lost for won, lost in match_table(serving, receiving, rules).values())


def normalised_score(rally_win: float, reference: float, best: float, *, error_bound: float = 0.0) -> float | None:
    """Score by the probability to win a rally against an opponent: 0 for a reference policy, 1 for the best response.

    Args:
        error_bound: absolute error bound of ``best - reference``.

    Returns:
        ``(rally_win - reference) / (best - reference)``; None if the best response may not be better than the reference.
    """
    return (rally_win - reference) / (best - reference) if best - error_bound > reference else None

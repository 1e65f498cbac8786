"""From the rally to the match: when is perfect play in every rally perfect play in the match?

A match is a binary Markov game: each rally is won or lost, and what follows depends on that alone. If winning a rally never
leaves a player with a lower chance of the match than losing it, at any score and whoever serves, then playing minimax in
every rally is minimax in the match (Walker, Wooders & Amir, Games and Economic Behavior 71, 2011). That is not self-evident,
because the winner of a rally serves next, and serving can be a disadvantage.
"""

from shuttle_marl.game.scoring import BWF, Rules, wins_game

Situation = tuple[int, int, int, int, int]
"""Games of players 0 and 1, their points, and who serves."""


def match_table(serving: float, receiving: float, rules: Rules = BWF) -> dict[Situation, tuple[float, float]]:
    """Chances that player 0 wins the match after winning and after losing the next rally, in every situation.

    Args:
        serving: chance that player 0 wins a rally that player 0 serves.
        receiving: chance that player 0 wins a rally that player 1 serves.
        rules: when a game and the match are won.
    """
    table: dict[Situation, tuple[float, float]] = {}

    def chance(games: tuple[int, int], points: tuple[int, int], server: int) -> float:
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
                after = (chance(games, (i + 1, j), 0), chance(games, (i, j + 1), 1))
                for server in (0, 1):
                    table[(*games, i, j, server)] = after
    return table


def least_gain(serving: float, receiving: float, rules: Rules = BWF) -> float:
    """What winning a rally adds to player 0's chance of the match where it adds least.

    Where this is not negative, rallies can be solved one by one: the condition of Walker, Wooders & Amir holds. What player
    0 gains player 1 loses, so it holds for both.
    """
    return min(won - lost for won, lost in match_table(serving, receiving, rules).values())

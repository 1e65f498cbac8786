"""Real matches: their rallies with the score, the rules, and the nearest strokes of the game."""

import collections
import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, cast

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import I64
from shuttle_marl.data.schema import REASONS, DataError, Outcome, changed, rally_starts
from shuttle_marl.game.court import seen_by, steps_between
from shuttle_marl.game.scoring import BWF, RULES, Rules, RulesName, Score, wins_game
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.game.tables import Game

Points = tuple[int, int]
_TELLING: Final = 2  # strokes of rallies that are equal by chance
_DECIDED: Final = (Outcome.FAULT, Outcome.WINNER)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RealRally:
    """A rally of a stroke table."""

    match: str
    number: tuple[int, int]  # of the rally in the data, with its game
    players: tuple[str, str]  # identifiers at seats 0 and 1; seat 0 strikes first in the match
    score: Score  # before the rally
    winner: int | None  # seat; None: not known
    after: Points  # points after the rally
    exact: bool  # whether these points are recorded, or all rallies of the game so far are there and their winners known
    rows: I64  # of its strokes in the table
    ended: Outcome  # outcome of its last stroke
    whole: bool  # whether no stroke is missing, from the serve to a fault or a winner
    stopped: bool  # whether the match was stopped in it


def real_rallies(strokes: pa.Table, rules: Mapping[str, Rules] | None = None) -> Iterator[RealRally]:
    """The rallies of a table of schema :data:`~shuttle_marl.data.schema.STROKES`, in its order, with the score of each.

    Points are those of the table, and where there are none those that the winners give; games are those of the table.

    Args:
        rules: by match; None: :func:`rules_of`.
    """
    rules = rules_of(strokes) if rules is None else rules
    names = ("match", "game", "rally", "stroke", "player", "opponent", "shot", "outcome")
    match, game, rally, stroke, player, opponent, shot, outcome = (strokes[n].to_numpy(zero_copy_only=False) for n in names)
    stopped = strokes["reason"].to_numpy() == REASONS.index("stopped")
    told = np.stack([strokes[name].to_numpy() for name in ("points", "points_opponent")], axis=1)
    last = -1
    for first, end in itertools.pairwise(rally_starts(strokes).tolist()):
        begins = last < 0 or match[first] != match[last]
        if begins:
            seats, score = (str(player[first]), str(opponent[first])), Score(rules=rules[match[first]])
        seat, rows = seats.index(player[first]), np.arange(first, end)
        server = seat if stroke[first] % 2 else 1 - seat
        if begins or game[first] != game[last]:
            if not begins:
                points, won, _ = game_end(score.points, server if rally[first] == 1 else None, score.rules)
                games = score.games[0] + (won == 0), score.games[1] + (won == 1)
                score = dataclasses.replace(score, points=(0, 0), games=games, finished=(*score.finished, points))
            exact, number = True, 0
        ended = Outcome(outcome[end - 1])
        winner = None if ended not in _DECIDED else seats.index((player if ended == Outcome.WINNER else opponent)[end - 1])
        before, known = score.points, not np.isnan(told[first]).any()
        exact = known or (exact and winner is not None and rally[first] == number + 1)
        after = (before[0] + (winner == 0), before[1] + (winner == 1))
        if known:
            after = int(told[first, seat]), int(told[first, 1 - seat])
            if winner is not None:
                before = max(0, after[0] - (winner == 0)), max(0, after[1] - (winner == 1))
        whole = stroke[first] == 1 and shot[first] < N_SERVES and bool((np.diff(stroke[rows]) == 1).all()) and winner is not None
        yield RealRally(
            match=str(match[first]),
            number=(int(game[first]), int(rally[first])),
            players=seats,
            score=dataclasses.replace(score, points=before, server=server),
            winner=winner,
            after=after,
            exact=exact,
            rows=rows,
            ended=ended,
            whole=whole,
            stopped=bool(stopped[end - 1]),
        )
        score, last, number = dataclasses.replace(score, points=after), first, int(rally[first])


Ends = Mapping[str, Mapping[int, RealRally]]  # the last rally of each game, by match and number of the game


def game_end(points: Points, served: int | None, rules: Rules, *, stopped: bool = False) -> tuple[Points, int | None, bool]:
    """Points at the end of a game, its winner or None, and whether its last rally is added because the rules leave one end.

    The leader was one rally away from the game, and did win it, because the leader served first in the next game, or because
    that is not known.

    Args:
        points: after its last rally in the data.
        served: who served first in the next game; None: not known.
        stopped: whether the match was stopped in its last rally, so that nobody won the game.
    """
    leader, (low, high) = int(points[1] > points[0]), sorted(points)
    over = not stopped and bool(wins_game(high, low, rules))
    missing = not over and not stopped and served in (leader, None) and bool(wins_game(high + 1, low, rules))
    if missing:
        points = (points[0] + (leader == 0), points[1] + (leader == 1))
    return points, leader if over or missing else served, missing


def game_ends(rallies: Sequence[RealRally]) -> dict[int, tuple[Points, int | None, bool]]:
    """:func:`game_end` of each game of a match, by its number."""
    ends = {}
    for rally, after in itertools.zip_longest(rallies, rallies[1:]):
        game = rally.number[0]
        if after is None or after.number[0] != game:
            served = after.score.server if after is not None and after.number[1] == 1 else None
            ends[game] = game_end(rally.after, served, rally.score.rules, stopped=after is None and rally.stopped)
    return ends


def winner_of(rallies: Sequence[RealRally]) -> int | None:
    """Seat that won a match; None: it was not finished."""
    games = collections.Counter(winner for _, winner, _ in game_ends(rallies).values())
    return next((seat for seat in (0, 1) if games[seat] >= rallies[0].score.rules.games), None)


def rules_of(strokes: pa.Table) -> dict[str, Rules]:
    """Rules of each match of a table: those that it carries, or else those that the scores tell."""
    carried = dict.fromkeys(strokes["match"].to_pylist()) | _carried(strokes)
    told = {} if all(carried.values()) else told_rules(_ends(strokes))[0]
    return {match: RULES[cast("RulesName", name or told[match])] for match, name in carried.items()}


def _carried(strokes: pa.Table) -> dict[str, RulesName]:
    both = zip(strokes["match"].to_pylist(), strokes["rules"].to_pylist(), strict=True)
    return {match: name for match, name in both if name}


_SPORT: Final = ("21", "15", "11")
Doubts = list[tuple[str, str]]  # matches, and what is not certain of each


def told_rules(matches: Ends) -> tuple[dict[str, RulesName], Doubts]:
    """Names of the rules by which the scores of each match are possible, and what is not certain. Those that allow most matches
    hold for all that they allow, of equal ones those of the sport."""
    fits = {match: {name: _fit(ends, rules) for name, rules in RULES.items()} for match, ends in matches.items()}
    least = {match: min(fit[:2] for fit in of_match.values()) for match, of_match in fits.items()}
    possible = {match: [name for name in RULES if fits[match][name][:2] == least[match]] for match in fits}
    votes = collections.Counter(itertools.chain(*possible.values()))
    usual = _usual([name for name in RULES if votes[name] == max(votes.values(), default=0)], fits.values())
    found = {match: usual if usual in names else _usual(names, [fits[match]]) for match, names in possible.items()}
    told: Doubts = []
    for match, name in found.items():
        finishing = [other for other in possible[match] if fits[match][other][2] < fits[match][name][2]]
        sure = name == "21" or (name in _SPORT and not fits[match][name][2])
        others = finishing if finishing or sure else [other for other in possible[match] if other != name]
        if others and not any(least[match]):
            told.append((match, f"the rules, {name}, are not certain: {', '.join(others)} fit too; name them with --rules"))
        elif name not in _SPORT:
            asked = "are all games of one match? Name the rules with --rules"
            told.append((match, f"the rules are {name}, by the scores, and not those of the sport, {', '.join(_SPORT)}: {asked}"))
        elif name != usual:
            told.append((match, f"the rules are {name}, by the scores, and those of most matches {usual}"))
        if least[match][0]:
            told.append((match, "the scores are possible by no rules: are games without a number, or two matches one?"))
    return found, told


def _ends(strokes: pa.Table) -> Ends:
    ends: dict[str, dict[int, RealRally]] = {match: {} for match in strokes["match"].unique().to_pylist()}
    for rally in real_rallies(strokes, dict.fromkeys(ends, BWF)):
        ends[rally.match][rally.number[0]] = rally
    return ends


def _usual(names: Sequence[RulesName], fits: Collection[Mapping[RulesName, tuple[int, ...]]]) -> RulesName:
    """Of several rules those of the sport, and else those that finish most matches."""
    return "21" if "21" in names else min(names, key=lambda name: sum(fit[name][2] for fit in fits))


def _fit(ends: Mapping[int, RealRally], rules: Rules) -> tuple[int, int, int]:
    """Of a match by the ends of its games: impossible scores, games without their last rally, 1 if not finished."""
    impossible = missing = 0
    games = [0, 0]
    for number, end in ends.items():
        low, high = sorted(end.after)
        impossible += max(games) >= rules.games or number >= 2 * rules.games
        won = game_end(end.after, None, rules)[1]
        if end.exact:
            impossible += bool(wins_game(high - 1, low, rules)) or (high == low > 0 and bool(wins_game(high, low - 1, rules)))
            missing += number < max(ends) and not wins_game(high, low, rules)
        games = [games[seat] + (won == seat) for seat in (0, 1)]
    return impossible, missing, int(max(games) < rules.games)


def with_rules(strokes: pa.Table, path: Path, rules: RulesName | None = None) -> tuple[pa.Table, tuple[str, ...]]:
    """The table with the rules of its matches, and sentences on what is not certain of them; ``rules``: of all matches (None:
    those that the table carries, in any row of a match, or else the scores tell). Raises DataError: a score is impossible by the
    rules that are given."""
    ends = _ends(strokes)
    given = dict.fromkeys(ends, rules) if rules else _carried(strokes)
    for match, name in given.items():
        if _fit(ends[match], RULES[name])[0]:
            scores = ", ".join(f"{own}-{other}" for own, other in (end.after for end in ends[match].values()))
            advice = f"give other --rules, one of {', '.join(RULES)}"
            raise DataError(path, f"match {match!r}, {scores}: by the rules {name} game or match were over before; {advice}")
    told, doubts = told_rules({match: games for match, games in ends.items() if match not in given})
    found = {**told, **given}
    groups: dict[str, list[str]] = {}
    for match, text in (*doubts, *_unfinished(ends, found)):
        groups.setdefault(text, []).append(match)
    sentences = [
        f"match {first!r}{f' and {len(others)} others' if others else ''}: {text}" for text, (first, *others) in groups.items()
    ]
    return changed(strokes, "rules", pa.array(map(found.get, strokes["match"].to_pylist()), pa.string())), tuple(sentences)


def _unfinished(ends: Ends, found: Mapping[str, RulesName]) -> Doubts:
    """Games that end before anybody has won them, or whose last rally counts and is not in the data."""
    told: Doubts = []
    for match, games in ends.items():
        rules, (*before, last) = RULES[found[match]], games.values()
        early = [end.after for end in before if end.exact and not wins_game(max(end.after), min(end.after), rules)]
        whole = [name for name in RULES if _fit(games, RULES[name]) == (0, 0, 0)]
        if early:
            about = f"a game ends {early[0][0]}-{early[0][1]}, before anybody has won it by the rules {found[match]}"
            why = f"by {', '.join(whole)} none does; give other --rules if they are these"
            asked = f"are rallies missing, or are the rules none of {', '.join(RULES)}?"
            told.append((match, f"{about}: {why if whole else asked}"))
        if not _fit(games, rules)[2] and game_end(last.after, None, rules, stopped=last.stopped)[2]:
            told.append((match, "the last rally is not in the data, and counts as won by who led"))
    return told


def event(match: str, players: tuple[str, str]) -> str:
    """Name of a match without its players: ``KOREA OPEN 2019 Final`` of ``Kento_MOMOTA_CHOU_Tien_Chen_KOREA_OPEN_2019_Final``."""
    words, (one, other) = match.replace("_", " ").split(), tuple(map(_letters, players))
    for first, end in itertools.combinations(range(len(words) + 1), 2):
        if end - first < len(words) and _letters("".join(words[first:end])) in (one + other, other + one):
            return " ".join(words[:first] + words[end:])
    return " ".join(words)


def _letters(text: str) -> str:
    return "".join(filter(str.isalnum, text.casefold()))


def nearest_stroke(game: Game, state: int, shot: int, technique: int, area: int | None, receiver: str = "right") -> int:
    """The legal stroke nearest to an annotated one: by shot type, then technique, then area; ``area``: as the receiver sees it
    (None: not known); ``receiver``: hand of the receiver."""
    legal, catalogue = game.legal_strokes(state), game.catalogue
    distance = 1000.0 * (catalogue.shot[legal] != shot) + 10.0 * (catalogue.technique[legal] != technique)
    if area is not None:
        distance = distance + steps_between(catalogue.area[legal].astype(int), seen_by(receiver, area))
    return int(legal[int(distance.argmin())])


def copies(strokes: pa.Table) -> list[str]:
    """Sentences on pairs of games that share half of their strokes, at least 10, in rallies of the same strokes."""
    names = strokes["match"].combine_chunks().dictionary_encode()
    match, names, game = names.indices.to_numpy(), names.dictionary.to_pylist(), strokes["game"].to_numpy()
    codes = np.stack([strokes[name].fill_null(-1).to_numpy() for name in ("shot", "technique", "area")], axis=1).astype(np.int8)
    owner: dict[bytes, tuple[int, int]] = {}
    total, shared = collections.Counter[tuple[int, int]](), collections.Counter[tuple[tuple[int, int], tuple[int, int]]]()
    for begin, end in itertools.pairwise(rally_starts(strokes).tolist()):
        unit = int(match[begin]), int(game[begin])
        first = owner.setdefault(codes[begin:end].tobytes(), unit)
        total[unit] += end - begin
        shared[first, unit] += (end - begin) * (end - begin > _TELLING)
    return [
        f"game {unit[1]} of {names[unit[0]]!r} has the strokes of game {first[1]} of {names[first[0]]!r}: are they one?"
        for (first, unit), count in shared.items()
        if first != unit and count >= max(10, 0.5 * min(total[first], total[unit]))
    ]


def absent(strokes: pa.Table) -> str:
    """A sentence on the rows that a table lacks by its own numbers; empty if it lacks none."""

    def lacking(number: str, *owner: str) -> int:
        """Numbers from 1 to the last one that are not there."""
        last, there = f"{number}_max", f"{number}_count_distinct"
        each = strokes.group_by(owner).aggregate([(number, "max"), (number, "count_distinct")])
        return int(each[last].to_numpy().sum() - each[there].to_numpy().sum())

    ends = strokes["outcome"].to_numpy()[rally_starts(strokes)[1:] - 1]
    counts = {
        "games": lacking("game", "match"),
        "rallies": lacking("rally", "match", "game"),
        "strokes": lacking("stroke", "match", "game", "rally"),
        "last strokes": int((ends == Outcome.RETURNED).sum()),
    }
    told = ", ".join(f"{n:,} {what}" for what, n in counts.items() if n)
    return f"by the numbers of the rows {told} are missing; what is counted is of those that are there" if told else ""

"""The task ``adapt``: play an unknown opponent for 500 rallies, and adapt."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from shuttle_marl.base.arrays import I8, I32, I64, Bools
from shuttle_marl.exact.odds import best_odds, pair_odds
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import play_rallies
from shuttle_marl.suite.method import Method, called, made
from shuttle_marl.suite.population import ADAPT_RALLIES, PEOPLE, Opponent, families, known, luck, opponent
from shuttle_marl.suite.task import POINTS, Arena, Case, Outcome, Setting, Task, exploitabilities, gains, required, table_of

CHANGES: Final = (0, 5, 20, 80, 240)  # rallies before which the policy may change
RISK_FROM: Final = 20  # rally from which the exploitability of the policies is averaged
_OPPONENTS: Final = 8  # of each family, which are the sample; so a seed is enough
_TOLERANCE: Final = 1e-4  # error bound of values, far below the differences between methods


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayedRally:
    """A rally that a method observes; its seat is 0."""

    state: I32  # [N] state of each stroke
    pair: I64  # [N] legal pair of the state and the stroke
    stroke: I32  # [N] catalogue index
    own: Bools  # [N] whether the method struck; else the opponent
    position: I8  # [N] where the receiver of each stroke waited, the opponent where `own`; the middle without recovery
    won: bool


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AdaptSetting(Setting):
    """Setting of ``adapt``, the argument of a method; nothing tells who the opponent is."""

    known: Mapping[str, TabulatedPolicy]  # known opponents by name; the opponent may be none of them


class Adapt(Task):
    """Adapt to an unknown opponent within 500 rallies.

    Given: the game, about 30 known opponents, and rallies against one that is not known, who may change or learn; the policy may
    change before rallies 0, 5, 20, 80 and 240. Score: the gain of ``exploit``, averaged over all rallies; also regret, the
    rallies lost against the best response to what the opponent plays; and exploitability of what is played from rally 20 on.
    """

    name = "adapt-v1"
    metric = "gain"
    zero = "perfect play, which uses no weakness"
    not_proved = "adaptation to people, safe play (see exploitability), and that the opponents were not computed beforehand"
    recovery = True
    seeds = 1
    hidden: ClassVar[tuple[str, ...]] = ("position of the receiver", "opponent")
    roles = tuple(map(str, CHANGES))
    protocol = "method(setting: AdaptSetting) -> object with observe_rally(rally) and policy_for_next_rally() -> player"

    def all_cases(self, arena: Arena) -> list[Case]:
        """Opponents of each family, and people, who do not count in the score and have a column of their own."""
        numbers = dict.fromkeys(families(arena.game)[: 1 if arena.quick else None], 1 if arena.quick else _OPPONENTS)
        if not arena.quick:
            numbers[PEOPLE] = _OPPONENTS
        return [
            Case(name=f"{family}/{number}", stratum=family, counts=family != PEOPLE, options={"family": family, "number": number})
            for family, size in numbers.items()
            for number in range(size)
        ]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:
        """Play the rallies; stores the policy that was played from each change on."""
        setting = AdaptSetting(game=arena.game, model=arena.model, known=known(arena), seed=seed, folder=folder)
        agent = made(method, setting, self.name, "observe_rally", "policy_for_next_rally")
        against, name = _opponent(arena, case), case.name.encode()
        words = [int.from_bytes(name[i : i + 7], "big") for i in range(0, len(name), 7)]
        tables: dict[int, TabulatedPolicy] = {}
        for start, last in _blocks(against):
            if start in CHANGES:
                tables[start] = table_of(called(self.name, agent.policy_for_next_rally), arena.game, self.name)
            key = luck(arena.split, arena.seed, seed, *words, start)
            for rally in observed(arena.game, _met(against, tables, start), last - start, key):
                called(self.name, agent.observe_rally, rally)
        return Outcome(policies={str(start): table for start, table in tables.items()})

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        """The opponent and the known population."""
        against = _opponent(arena, case)
        hashes = (policy.hash for policy in (*against.policies, *known(arena).values()))
        return (*map(str, against.starts), repr(against.learns), *hashes)

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Gain, the largest possible one, mean regret, and exploitability, in points."""
        against = _opponent(arena, case)
        tables = {start: required(outcome, str(start)) for start in CHANGES}
        blocks = _blocks(against)
        played = [_met(against, tables, start) for start, _ in blocks]
        opponents, rallies = list({id(policy): policy for _, policy in played}.values()), [last - start for start, last in blocks]
        most = dict(zip(map(id, opponents), best_odds(opponents, tolerance=_TOLERANCE), strict=True))
        won = pair_odds(played, tolerance=_TOLERANCE)
        regret = [POINTS * (most[id(policy)].rally - odds.rally) for (_, policy), odds in zip(played, won, strict=True)]
        ends = dict(zip(CHANGES, (*CHANGES[1:], ADAPT_RALLIES), strict=True))
        at_risk = [start for start in CHANGES if start >= RISK_FROM]
        risk = exploitabilities([tables[start] for start in at_risk], tolerance=_TOLERANCE)
        gain, best = gains(arena, played, rallies=rallies, tolerance=_TOLERANCE)
        return {
            "gain": gain,
            "best": best,
            "regret": float(np.average(regret, weights=rallies)),
            "exploitability": float(np.average(risk, weights=[ends[start] - start for start in at_risk])),
        }


def _opponent(arena: Arena, case: Case) -> Opponent:
    return opponent(arena, case.options["family"], case.options["number"])


def _blocks(against: Opponent) -> list[tuple[int, int]]:
    """First rally and end of the rallies in which neither side changes."""
    starts = sorted({*CHANGES, *against.starts})
    return list(zip(starts, (*starts[1:], ADAPT_RALLIES), strict=True))


def _met(against: Opponent, tables: Mapping[int, TabulatedPolicy], start: int) -> tuple[TabulatedPolicy, TabulatedPolicy]:
    """What is played from a rally on, and by the opponent, who may have learned from what was played before the last change."""
    changed = [change for change in CHANGES if change <= start]
    return tables[changed[-1]], against.at(start, tables[changed[-2]] if len(changed) > 1 else None)


def observed(game: Game, players: tuple[TabulatedPolicy, TabulatedPolicy], number: int, seed: int) -> Iterable[PlayedRally]:
    """Play rallies of two policies, as the player at seat 0 observes them."""
    rallies = play_rallies(game, players, number, seed=seed)
    state, stroke = rallies.states(game), rallies.stroke.astype(np.int32)
    pair, own = game.pair(state, stroke).astype(np.int64), rallies.striker == 0
    for i in range(len(rallies)):
        part = slice(*rallies.first_stroke[[i, i + 1]].tolist())
        won = bool(rallies.winner[i] == 0)
        yield PlayedRally(
            state=state[part], pair=pair[part], stroke=stroke[part], own=own[part], position=rallies.places[part], won=won
        )

"""The task ``adapt-v0``: play an unknown opponent for 500 rallies, and adapt."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from shuttle_marl.base.arrays import I32, I64, Bools
from shuttle_marl.exact.known import best_odds, pair_odds
from shuttle_marl.game.draws import stream
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import play_rallies
from shuttle_marl.suite.frontier import objective
from shuttle_marl.suite.method import Method, called, made
from shuttle_marl.suite.options import Split
from shuttle_marl.suite.population import ADAPT_RALLIES, CONTROL, FAMILIES, Opponent, known, opponent
from shuttle_marl.suite.task import Arena, Case, Outcome, Setting, Task, required, table_of

CHANGES: Final = (0, 2, 5, 10, 20, 40, 80, 160, 320)
"""Rallies before which the policy may change."""
HORIZONS: Final = (20, 100, 500)
"""Numbers of rallies over which the regret is averaged."""
RISK_FROM: Final = 20
"""Rally from which the exploitability of the policies is averaged."""
_OPPONENTS: Final = 10
_CONTROLS: Final = 5
_TOLERANCE: Final = 1e-5
"""Error bound of values, far below the differences between methods."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayedRally:
    """A rally that a method observes; its seat is 0.

    Attributes:
        state: ``[N]`` state of each stroke.
        pair: ``[N]`` legal pair of the state and the stroke.
        stroke: ``[N]`` catalogue index.
        own: ``[N]`` whether the method struck; else the opponent.
    """

    state: I32
    pair: I64
    stroke: I32
    own: Bools
    won: bool


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AdaptSetting(Setting):
    """Setting of ``adapt``, the argument of a method; nothing tells who the opponent is.

    Attributes:
        known: known opponents by name; the opponent may be none of them.
    """

    known: Mapping[str, TabulatedPolicy]


class Adapt(Task):
    """Adapt to an unknown opponent within 500 rallies.

    Given: the game, about 25 known opponents, and rallies against one that is not known; the policy may change before rallies 0,
    2, 5, 10, 20, 40, 80, 160 and 320. Score: the restricted Nash objective of ``exploit``, averaged over all rallies; also
    regret, the fraction of rallies lost against the best response to what the opponent plays, over 20, 100 and 500 rallies; and
    exploitability of what is played from rally 20 on.
    """

    name = "adapt-v0"
    metric = "objective"
    roles = tuple(map(str, CHANGES))
    optimum = 1.0
    seeds = 1
    splits: ClassVar[tuple[Split, ...]] = ("dev", "test", "hidden")
    protocol = "method(setting: AdaptSetting) -> object with observe_rally(rally) and policy_for_next_rally() -> player"
    target = "an objective above .9"
    hard = 0.9

    def all_cases(self, arena: Arena) -> list[Case]:
        """Opponents of each family, and controls, which do not count in the score."""
        numbers = dict.fromkeys(FAMILIES[: 2 if arena.quick else None], 1 if arena.quick else _OPPONENTS)
        if not arena.quick:
            numbers[CONTROL] = _CONTROLS
        return [
            Case(
                name=f"{family}/{number}", stratum=family, counts=family != CONTROL, options={"family": family, "number": number}
            )
            for family, size in numbers.items()
            for number in range(size)
        ]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:
        """Play the rallies; stores the policy that was played from each change on."""
        setting = AdaptSetting(game=arena.game, known=known(arena), seed=seed, folder=folder)
        agent = made(method, setting, self.name, "observe_rally", "policy_for_next_rally")
        against, name, policies = _opponent(arena, case), case.name.encode(), {}
        for start, policy_at, last in _blocks(against):
            if start in CHANGES:
                table = table_of(called(self.name, agent.policy_for_next_rally), arena.game, self.name)
                policies[str(start)] = table
            words = (int.from_bytes(name[i : i + 7], "big") for i in range(0, len(name), 7))
            key = int(stream(seed, *words, start)[0] >> np.uint64(1))
            for rally in observed(arena.game, (table, policy_at), last - start, key):
                called(self.name, agent.observe_rally, rally)
        return Outcome(policies=policies)

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        """The opponent and the known population."""
        against = _opponent(arena, case)
        hashes = (policy.hash for policy in (*against.policies, *known(arena).values()))
        return (*map(str, against.starts), *hashes)

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Objective, mean regret over each horizon, and exploitability."""
        against = _opponent(arena, case)
        tables = [required(outcome, str(start)) for start in CHANGES]
        regret, blocks = np.zeros(ADAPT_RALLIES), _blocks(against)
        played = [(tables[np.searchsorted(CHANGES, start, side="right") - 1], policy) for start, policy, _ in blocks]
        most = dict(zip(against.policies, best_odds(against.policies, tolerance=_TOLERANCE), strict=True))
        for (start, policy, last), odds in zip(blocks, pair_odds(played, tolerance=_TOLERANCE), strict=True):
            regret[start:last] = most[policy].rally - odds.rally
        at_risk = [
            (start, last) for start, last in zip(CHANGES, (*CHANGES[1:], ADAPT_RALLIES), strict=True) if start >= RISK_FROM
        ]
        risk = best_odds([tables[CHANGES.index(start)] for start, _ in at_risk], tolerance=_TOLERANCE)
        return {
            "objective": objective(arena, played, rallies=[last - start for start, _, last in blocks], tolerance=_TOLERANCE),
            **{f"regret_{horizon}": float(regret[:horizon].mean()) for horizon in HORIZONS},
            "exploitability": float(np.average([odds.value for odds in risk], weights=[last - start for start, last in at_risk])),
        }


def _opponent(arena: Arena, case: Case) -> Opponent:
    return opponent(arena, case.options["family"], case.options["number"])


def _blocks(against: Opponent) -> list[tuple[int, TabulatedPolicy, int]]:
    """Rallies in which neither side changes: first one, policy of the opponent, and end."""
    starts = sorted({*CHANGES, *against.starts})
    return [(start, against.at(start), last) for start, last in zip(starts, (*starts[1:], ADAPT_RALLIES), strict=True)]


def observed(game: Game, players: tuple[TabulatedPolicy, TabulatedPolicy], number: int, seed: int) -> Iterable[PlayedRally]:
    """Play rallies of two policies, as the player at seat 0 observes them."""
    rallies = play_rallies(game, players, number, seed=seed)
    state, stroke = rallies.states(game), rallies.stroke.astype(np.int32)
    pair, own = game.pair(state, stroke).astype(np.int64), rallies.striker == 0
    for i in range(len(rallies)):
        part = slice(*rallies.first_stroke[[i, i + 1]].tolist())
        yield PlayedRally(
            state=state[part], pair=pair[part], stroke=stroke[part], own=own[part], won=bool(rallies.winner[i] == 0)
        )

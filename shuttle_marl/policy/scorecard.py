"""Exact scores of a policy: against the behaviour-cloned average player, against its best response, against perfect play.

The depth of a game is what policies play in it, how rare that is among people, and how far policies get that read little.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.exact.fixed_point import Odds
from shuttle_marl.exact.occupancy import Visits, policy_regret, visits
from shuttle_marl.exact.odds import best_odds, normalised_score, over
from shuttle_marl.exact.optimal import Solution, best_response, solve
from shuttle_marl.exact.play import averaged, cells_of, impossible, lists, play, unusual
from shuttle_marl.exact.profile import evaluate, moved
from shuttle_marl.game.policy import Policy, TabulatedPolicy, tabulate
from shuttle_marl.game.recovery import NO_CHOICE
from shuttle_marl.game.shipped import Estimate, real_play, real_strokes
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.policy.computed import deterministic
from shuttle_marl.policy.registry import resolve

REFERENCE: Final = "bc"  # the opponent of the benchmark: the behaviour-cloned average player
HEADLINES: Final = ("rally_win_vs_bc", "match_win_vs_bc", "exploitability")
"""Figures of a scorecard that are also computed away from home."""
FEW_STROKES: Final = 5  # a stroke with fewer examples in the data counts as thin
_AWAY: Final = 1e-6  # error bound of values away from home, far below the differences between refits
_ENDINGS: Final = ("own winner", "fault of the opponent", "winner of the opponent", "own fault")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scorecard:
    """Exact scores of one policy.

    Attributes:
        rally_win_vs_bc: probability to win a rally against ``bc``, both serving equally often.
        rally_win_serving: the same in rallies that the policy serves.
        rally_win_receiving: the same in rallies that ``bc`` serves.
        match_win_vs_bc: probability to win a match against ``bc``, the first serve drawn at random.
        exploitability: gain of the best response to the policy, as a value from 0 to 1; it wins
            ``(1 + exploitability) / 2`` of the rallies.
        gap_at_serve: V* - V^pi at the serve, with pi against its best response.
        normalised_score: 0 for ``bc``, 1 for the best response to it:
            ``(J(pi) - J(bc)) / (J(best response to bc) - J(bc))`` with J = ``rally_win_vs_bc``.
        regret_per_rally: V* - V^pi against perfect play, both serving equally often.
        rally_length_vs_bc: expected strokes of a rally against ``bc``.
        shot_mix_vs_bc: fraction of each shot type in the policy's strokes there.
        thin_vs_bc: fraction of the policy's strokes there with fewer than :data:`FEW_STROKES` examples in the data
            (:func:`shuttle_marl.game.shipped.real_strokes`); None if the model has no counts.
        away: the figures :data:`HEADLINES` in the refits of the game, with the policy and ``bc`` tabulated at home and best
            responses in the refit, within 1e-6; None without refits.
        error_bound: absolute error bound of all exact figures but ``match_win_vs_bc``.
        match_error_bound: absolute error bound of ``match_win_vs_bc``.
    """

    policy: str
    rally_win_vs_bc: float
    rally_win_serving: float
    rally_win_receiving: float
    match_win_vs_bc: float
    exploitability: float
    gap_at_serve: float
    normalised_score: float | None
    regret_per_rally: float
    rally_length_vs_bc: float
    endings_vs_bc: dict[str, float]
    shot_mix_vs_bc: dict[str, float]
    thin_vs_bc: float | None
    away: Mapping[str, Estimate] | None
    error_bound: float
    match_error_bound: float

    @property
    def home(self) -> dict[str, float | None]:
        """The figures :data:`HEADLINES` in the game itself."""
        return {name: getattr(self, name) for name in HEADLINES}

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON, ``home`` too."""
        away = None if self.away is None else {name: figure._asdict() for name, figure in self.away.items()}
        return {**dataclasses.asdict(dataclasses.replace(self, away=None)), "home": self.home, "away": away}


class Scorer:
    """Scores policies on one game; solves the game and the best response to ``bc`` once, when first needed.

    Args:
        refits: two or more other fits of the game, for figures away from home; empty: no such figures.

    Raises:
        PolicyError: the game has no behaviour-cloned players.
    """

    def __init__(self, game: Game, *, refits: Sequence[Game] = ()) -> None:
        self.game, self.refits = game, tuple(refits)
        self.reference = tabulate(resolve(REFERENCE, game), game)

    @functools.cached_property
    def solution(self) -> Solution:
        """The solved game."""
        return solve(self.game)

    @functools.cached_property
    def reference_best(self) -> Odds:
        """Odds of the best response to ``bc`` against it."""
        return best_odds([self.reference])[0]

    def normalised(self, rally_win_vs_bc: float) -> float | None:
        """The normalised score of a probability to win a rally against ``bc``; None if nothing beats ``bc``."""
        best = self.reference_best
        # bc wins exactly half of the rallies against itself.
        return normalised_score(rally_win_vs_bc, 0.5, best.rally, error_bound=best.error_bound)

    def score(self, policy: Policy, name: str) -> Scorecard:
        """The figures of a policy.

        Raises:
            PolicyError: the policy reads the score, raised, or returned no distribution over the legal strokes.
            ExactError: play may never end.
        """
        policy = tabulate(policy, self.game)
        odds = evaluate(policy, self.reference).odds()
        answer = best_response(policy)
        loss = policy_regret(policy, solution=self.solution)
        seen = visits(policy, self.reference)
        endings = dict(zip(_ENDINGS, seen.endings().values(), strict=True))
        score, best = self.normalised(odds.rally), self.reference_best
        bounds = [
            odds.error_bound,
            answer.value.error_bound,
            self.solution.error_bound + answer.value.error_bound,
            loss.error_bound,
            seen.error_bound,
            0.0 if score is None else (odds.error_bound + abs(score) * best.error_bound) / (best.rally - best.error_bound - 0.5),
        ]
        return Scorecard(
            policy=name,
            rally_win_vs_bc=odds.rally,
            rally_win_serving=odds.serving,
            rally_win_receiving=odds.receiving,
            match_win_vs_bc=odds.match(),
            exploitability=answer.value.odds().value,
            gap_at_serve=self.solution.value_at_serve - float(answer.value.striking[1][ROOT]),
            normalised_score=score,
            regret_per_rally=loss.per_rally,
            rally_length_vs_bc=seen.rally_length,
            endings_vs_bc=endings,
            shot_mix_vs_bc=dict(zip(SHOTS, seen.shot_mix(0).tolist(), strict=True)),
            thin_vs_bc=self._thin_share(seen),
            away=over(self.refits, functools.partial(self._headlines, policy)) if self.refits else None,
            error_bound=max(bounds),
            match_error_bound=odds.match_error_bound(),
        )

    def _thin_share(self, seen: Visits) -> float | None:
        behind, played = real_strokes(self.game), seen.base_pairs(0).sum(axis=0)
        return None if behind is None else float(played[behind[self.game.base_pair_edge] < FEW_STROKES].sum() / played.sum())

    def _headlines(self, policy: TabulatedPolicy, refit: Game) -> dict[str, float]:
        there = moved(policy, refit)
        odds = evaluate(there, moved(self.reference, refit), tolerance=_AWAY).odds()
        gain = best_response(there, tolerance=_AWAY).value.odds().value
        return dict(zip(HEADLINES, (odds.rally, odds.match(), gain), strict=True))


_SURE: Final = 0.99
POLICIES: Final = ("minimax", "best-response:bc", "bc", "ppo", "a2c", "sac", "ppo:self-play", "human:0.05", "human:0.02")
_ALL: Final = ("own", "incoming", "contact", "duel", "effort", "opponent_effort", "hurried")
LISTS: Final = {
    "nothing": (),
    "incoming_shot": ("incoming_shot", "contact"),
    "incoming_stroke": ("incoming", "contact"),
    "no_own": tuple(part for part in _ALL if part != "own"),
    "no_hurried": tuple(part for part in _ALL if part != "hurried"),
}
"""What the policies of each class read; all of them see the contact offered, which decides what is legal."""


def depth(game: Game, names: Sequence[str] = POLICIES, *, report: Callable[[str], None]) -> dict[str, Any]:
    """The depth table of a game.

    Returns:
        ``impossible``: number of legal pairs that nobody can play (:func:`shuttle_marl.exact.play.impossible`). ``policies``:
        for each name :func:`shuttle_marl.exact.play.play` against itself (``self``) and against ``bc``. ``people``: the same of
        people, without ``rare`` (:func:`shuttle_marl.game.shipped.real_play`).
        ``lists``: for each class of :data:`LISTS` ``score`` (edge over ``bc``, 1 for the best response), ``exploitability`` and
        ``against_minimax`` (fraction of rallies won against perfect play), each of the best policy found in the class: improved
        lists against ``bc`` and against perfect play, and the mean of perfect play over the cells. With recovery, lists wait as
        perfect play does, and :func:`hidden_depth` follows.
    """
    bc = tabulate(resolve("bc", game), game)
    rare = unusual(bc)
    played = {}
    for name in names:
        report(name)
        policy = bc if name == "bc" else tabulate(resolve(name, game), game)
        played[name] = {"self": play(policy, policy, rare), "bc": play(policy, bc, rare)}
    perfect = solve(game).policy[0]
    best = best_response(bc).value.odds().rally
    classes = {}
    for name, parts in LISTS.items():
        report(f"lists that read {name.replace('_', ' ')}")
        cell = cells_of(game, *parts)
        found = [*lists(bc, cell, perfect.waits), *lists(perfect, cell, perfect.waits), averaged(perfect, perfect, cell)]
        classes[name] = {
            "score": max((evaluate(each, bc).odds().rally - 0.5) / (best - 0.5) for each in found),
            "exploitability": min(best_response(each).value.odds().value for each in found),
            "against_minimax": max(evaluate(each, perfect).odds().rally for each in found),
        }
    figures = {
        "game": game.hash,
        "impossible": int(impossible(game).sum()) * game.n_blocks,
        "policies": played,
        "people": real_play(game),
        "lists": classes,
    }
    return {**figures, **hidden_depth(perfect)} if game.hides else figures


def hidden_depth(perfect: TabulatedPolicy) -> dict[str, Any]:
    """What the hidden position asks of players.

    Args:
        perfect: perfect play of a game with recovery.

    Returns:
        ``mixed``: fraction of perfect play's choices of ``strokes`` and ``positions`` in which none has a probability of .99 or
        more. ``purified``: fraction of rallies that a best response wins against the deterministic policy of its most likely
        choices. ``ignores_position``: the same against perfect play of the game without recovery that waits as people do.
    """
    game, seen = perfect.game, visits(perfect, perfect)
    strokes, positions = np.zeros(game.n_states), perfect.position_probabilities()
    np.maximum.at(strokes, game.pair_state, perfect.pair_probabilities())
    mixed = {
        name: float(weight[largest < _SURE].sum() / weight.sum())
        for name, largest, weight in (("strokes", strokes, seen.states[0]), ("positions", positions.max(axis=1), seen.states[1]))
    }
    without = solve(dataclasses.replace(game, recovery=NO_CHOICE)).policy[0]
    return {
        "mixed": mixed,
        "purified": best_response(deterministic(perfect)).value.odds().rally,
        "ignores_position": best_response(moved(without, game)).value.odds().rally,
    }

"""Methods of ``exploit`` and ``equilibrium``: references, methods that estimate, and learners.

References compute from the tables of the game, and use no strokes. The other methods estimate something from play, and solve what
they estimated. Strokes are those of the learner, and with recovery its positions too, one for each stroke of the opponent.
Learners are those of :mod:`shuttle_marl.training`, which train in the game of a model, so not in the drawn game of a round.
"""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base import runs
from shuttle_marl.exact import best_response as exact_response
from shuttle_marl.exact import restricted_response, solve
from shuttle_marl.exact.play import cells_of, lists
from shuttle_marl.exact.profile import PairPolicy, positions_of, tabulated_pairs
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import load_game
from shuttle_marl.policy.computed import deterministic, minimax_policy, mixture
from shuttle_marl.recording.logs import Log, play_log
from shuttle_marl.suite.adapt import observed
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.method import find
from shuttle_marl.suite.methods.adapters import chances, counted, mean_of, mixture_weights, respond, struck
from shuttle_marl.suite.methods.logs import boosted, boosted_game
from shuttle_marl.suite.offline import fitted, in_game
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.tabular import SHRINK, cloned, estimated_game, game_of
from shuttle_marl.suite.task import WEIGHT, Setting

_STEPS: Final = 30  # iterations of fictitious play
_COUNTED: Final = 300_000  # strokes from which on more counts of an opponent change little
_FITTED: Final = 400_000  # the same for trees
_STROKES: Final = 8  # more strokes of both players than rallies have on average
_TYPES: Final = ("bc", "bc@0.5", "attacking", "defensive", "safe", "human:0.05", "random")
"""Policies that opponents may be mixtures of."""
_EXPLORE: Final = 0.2  # fraction of random strokes in the second half of the play
_MARGIN: Final = 200  # strokes that are left for the end of the last rally


def named(setting: PlayerSetting, argument: str) -> Trained:  # noqa: ARG001
    """A policy of the package, whose name is the argument."""
    return Trained(player=argument, strokes=0)


def minimax_deterministic(setting: PlayerSetting) -> Trained:
    """Perfect play that always makes its likeliest choice."""
    return Trained(player=deterministic(setting.policy("minimax")), strokes=0)


def best_response(setting: PlayerSetting) -> Trained:
    """The exact best response to the opponent, which is exploited in turn."""
    return Trained(player=f"best-response:{setting.opponent}", strokes=0)


def restricted(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """The exact restricted response to the opponent, the upper bound of ``exploit``; the argument is the restriction."""
    return Trained(player=restricted_response(setting.against, float(argument)).policy, strokes=0)


def constant(setting: PlayerSetting, *parts: str) -> Trained:
    """The best order of preference of the strokes for all states, or for each value of some parts of the state.

    It shows how little of the state an opponent's weaknesses need (:mod:`shuttle_marl.exact.play`).
    """
    *_, best = [setting.against, *lists(setting.against, cells_of(setting.game, *parts))]
    return Trained(player=best, strokes=0)


def constant_by_incoming(setting: PlayerSetting) -> Trained:
    """The best orders of preference for each incoming shot type and contact."""
    return constant(setting, "incoming_shot", "contact")


def fictitious_play(setting: PlayerSetting) -> Trained:
    """Fictitious play with exact best responses, averaged state by state (Sayin, Parise & Ozdaglar 2022, arXiv 2010.04223)."""
    game = setting.game
    first = setting.policy("bc")
    mean, places = first.pair_probabilities(), positions_of(first)
    for step in range(_STEPS):
        answer = exact_response(PairPolicy(game=game, probability=mean, positions=places), tolerance=1e-6).policy
        mean += (answer.pair_probabilities() - mean) / (step + 2)
        places = places + (positions_of(answer) - places) / (step + 2)
    return Trained(player=tabulated_pairs(PairPolicy(game=game, probability=mean, positions=places)), strokes=0)


def restricted_counts(setting: PlayerSetting, argument: str = str(WEIGHT), names: Sequence[str] = ("bc",)) -> Trained:
    """Counts of the opponent's choices against perfect play, shrunken towards bc, and the restricted response in the game.

    The restriction is fixed; that of a data-biased response (Johanson & Bowling, AISTATS 2009) grows with the counts of a state.
    """
    game, types = setting.game, tuple(map(setting.policy, names))
    number = max(1, min(setting.budget, _COUNTED) // _STROKES)
    seen = list(observed(game, (minimax_policy(game), setting.against), number, setting.seed))
    weight = mixture_weights(chances(types)[:, struck(seen) % game.n_base_pairs], np.ones(len(types)))[0]
    prior = mean_of(types, weight)
    used = sum(len(rally.own) if game.hides else int(rally.own.sum()) for rally in seen)
    return Trained(player=respond(counted(prior, seen), float(argument)), strokes=used)


def restricted_mixture(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """The same with counts that are shrunken towards a mixture of policies of the package, fitted to them."""
    return restricted_counts(setting, argument, _TYPES)


def from_log(setting: PlayerSetting, argument: str) -> Trained:
    """A method of ``offline``, whose name is the argument, from a log of random play against the opponent."""
    log, used = _random_log(setting, setting.against)
    learner = Setting(game=log.game, model=setting.model, seed=setting.seed, folder=setting.folder)
    player = fitted(find("offline-v0", argument), log, learner, argument)
    return Trained(player=in_game(player, setting.game), strokes=used)


def solved_model(setting: PlayerSetting, argument: str) -> Trained:
    """Perfect play in a model of random play: outcomes by shrunken means (``means``) or boosted trees (``trees``).

    The model has no positions, so the solution does not mix.
    """
    log, used = _random_log(setting, setting.policy("random"))
    game = estimated_game(log) if argument == "means" else boosted_game(log, 150, setting.seed)
    return Trained(player=in_game(solve(game, tolerance=1e-6).policy[0], setting.game), strokes=used)


def _random_log(setting: PlayerSetting, opponent: TabulatedPolicy) -> tuple[Log, int]:
    """A log of random play within the budget in a game without positions, and the strokes of the learner."""
    game, both = setting.game, setting.opponent is None
    # A position, or a stroke of the other side, for each stroke.
    share = (1 + both) * (1 + game.hides)
    log = play_log((setting.policy("random"), opponent), min(setting.budget, share * _FITTED) * 9 // (10 * share), setting.seed)
    used = int(log.own.sum()) if share == 1 else len(log) * share // 2
    return dataclasses.replace(log, game=dataclasses.replace(log.game, recovery=None)), used


def model_boosted(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """Outcomes by boosted trees from play, first at random and then as planned, and the restricted response in that model.

    The model has no positions, which it does not see: it waits as people do.
    """
    game, uniform = setting.game, setting.policy("random")
    plain, hidden = dataclasses.replace(game, recovery=None), game.hides
    player, rows, used = uniform, [], 0
    budget = min(setting.budget // (1 + hidden), _FITTED)
    for turn in range(2):
        log = play_log((player, setting.against), budget * 9 // 20 - _MARGIN, 2 * setting.seed + turn)
        used += len(log) if hidden else int(log.own.sum())
        rows.append((log.pair, log.outcome, log.pair[~log.own]))
        pair, outcome, theirs = (np.concatenate(column) for column in zip(*rows, strict=True))
        shares = boosted(plain, pair, outcome, 150, setting.seed, objective="multiclass", num_class=len(OUTCOMES))
        model = game_of(plain, shares)
        estimate = PairPolicy(game=model, probability=cloned(plain, theirs, shrink=SHRINK))
        found = TabulatedPolicy(game=game, cumulative=respond(estimate, float(argument)).cumulative)
        player = mixture([found, uniform], [1 - _EXPLORE, _EXPLORE])
    return Trained(player=found, strokes=used)


_SHARE: Final = 0.94
"""Fraction of the budget that is planned; the rest is for the ends of rallies, and for choices that are not the learner's."""
_LESS: Final = 0.97  # factor of the planned strokes until they fit
_SHARES: Final = {50_000: 0.5, 200_000: 0.65}
"""The same of budgets up to these: rallies become longer while a player learns, and few batches follow late."""
_ITERATIONS: Final = 12  # iterations of a run with a small budget


def learner(setting: PlayerSetting, argument: str, **options: Any) -> Trained:
    """The agent of a learning algorithm, with options of its configuration.

    PPO (Schulman et al. 2017, arXiv 1707.06347), A2C (Mnih et al. 2016, arXiv 1602.01783), or SAC (Haarnoja et al. 2018, arXiv
    1801.01290) for discrete actions (Christodoulou 2019, arXiv 1910.07207).
    """
    from shuttle_marl.training import train  # noqa: PLC0415  torch
    from shuttle_marl.training.config import CONFIGS  # noqa: PLC0415

    if load_game(setting.model).hash != setting.game.hash:
        raise SuiteError(f"{argument} trains in the game of a model, and this game is drawn")
    default, folder = CONFIGS[argument], setting.folder / argument
    config = default(
        opponent=(setting.opponent or "self",),
        strokes=setting.budget,
        batch=min(default().batch, max(256, setting.budget // _ITERATIONS)),
        seed=setting.seed,
        game=setting.model,
        record="none",
        exploitability=False,
        out=folder,
        resume=(folder / runs.CONFIG).exists(),
        **options,
    )
    # Rallies are played to their end, so iterations are a little longer than their batches.
    share = next((share for most, share in _SHARES.items() if setting.budget <= most), _SHARE)
    while sum(map(config.batch_of, range(config.iterations))) > share * setting.budget:
        config = dataclasses.replace(config, strokes=int((config.strokes or 0) * _LESS))
    done = train(config)
    points = [json.loads(line) for line in (done.folder / runs.METRICS).read_text(encoding="utf-8").splitlines()]
    figure = "normalised_score" if setting.opponent is not None else "exploitability"
    curve = tuple((int(point["strokes"]), float(point[figure])) for point in points if point[figure] is not None)
    return Trained(player=done.policy, strokes=done.strokes, curve=curve)


def ppo_variant(setting: PlayerSetting, argument: str) -> Trained:
    """PPO in a variant of self-play, see :mod:`shuttle_marl.training.self_play`."""
    # Rallies that start in a state of the best response are of another length, so more strokes are kept back.
    planned = dataclasses.replace(setting, budget=setting.budget * 49 // 50) if argument == "restarts" else setting
    return learner(planned, "ppo", variant=argument)


def ppo_self_play(setting: PlayerSetting) -> Trained:
    """PPO in self-play, which does not look at the opponent."""
    return learner(dataclasses.replace(setting, opponent=None), "ppo")


def ppo_deterministic(setting: PlayerSetting) -> Trained:
    """PPO in self-play, whose agent always makes its likeliest choice."""
    found = learner(setting, "ppo")
    return dataclasses.replace(found, player=deterministic(tabulate(found.player, setting.game)), curve=())

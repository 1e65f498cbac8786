"""Methods of ``exploit`` and ``equilibrium``: references, methods that estimate, and learners.

References compute from the tables of the game, and use no strokes. The other methods estimate something from play, and solve what
they estimated. Strokes are those of the learner, and with recovery its positions too, one for each stroke of the opponent.
Learners are those of :mod:`shuttle_marl.training`.
"""

import dataclasses
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import Bools
from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.play import cells_of, lists
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import deterministic, minimax_policy, mixture
from shuttle_marl.recording.logs import blank, play_log
from shuttle_marl.suite.adapt import observed
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.methods.adapters import counted, respond, tilted_positions
from shuttle_marl.suite.methods.logs import boosted
from shuttle_marl.suite.offline import in_game
from shuttle_marl.suite.tabular import SHRINK, cloned, game_of, with_positions
from shuttle_marl.suite.task import WEIGHT

_COUNTED: Final = 300_000  # strokes from which on more counts of an opponent change little
_STROKES: Final = 8  # more strokes of both players than rallies have on average
_EXPLORE: Final = 0.2  # fraction of random strokes in the second half of the play
_FITTING: Final[dict[str, Any]] = {"learning_rate": 0.1, "cat_smooth": 5, "feature_fraction": 0.6, "feature_fraction_seed": 0}
_COLUMNS: Final = (*range(8), 9, 12, 13)  # of the description of a stroke; of the own last one the area alone
_MARGIN: Final = 200  # strokes that are left for the end of the last rally


def named(setting: PlayerSetting, argument: str) -> Trained:  # noqa: ARG001
    """A policy of the package, whose name is the argument."""
    return Trained(player=argument, strokes=0)


def minimax_deterministic(setting: PlayerSetting) -> Trained:
    """Perfect play that always makes its likeliest choice."""
    return Trained(player=deterministic(setting.policy("minimax")), strokes=0)


def restricted(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """The exact restricted response to the opponent, the upper bound of ``exploit``; the argument is the restriction."""
    return Trained(player=restricted_response(setting.against, float(argument)).policy, strokes=0)


def restricted_bc(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """The same response to bc, whoever plays: what is won by knowing people, and nothing of the opponent."""
    return Trained(player=restricted_response(setting.policy("bc"), float(argument)).policy, strokes=0)


def constant(setting: PlayerSetting, *parts: str) -> Trained:
    """The best order of preference of strokes, or one by some parts of the state: how little an opponent's weaknesses need."""
    *_, best = [setting.against, *lists(setting.against, cells_of(setting.game, *parts))]
    return Trained(player=best, strokes=0)


def constant_by_incoming(setting: PlayerSetting) -> Trained:
    """The best orders of preference for each incoming shot type and contact."""
    return constant(setting, "incoming_shot", "contact")


def decisions(game: Game, own: Bools) -> int:
    """Decisions of a player: the strokes that are their own, and with recovery a position at each of the other strokes."""
    return int(own.sum()) + game.hides * int((~own).sum())


def restricted_counts(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """Counts of the opponent's choices against perfect play, shrunken towards bc, and the restricted response in the game.

    The restriction is fixed; that of a data-biased response (Johanson & Bowling, AISTATS 2009) grows with the counts of a state.
    """
    game = setting.game
    number = max(1, min(setting.budget, _COUNTED) // _STROKES)
    seen = list(observed(game, (minimax_policy(game), setting.against), number, setting.seed))
    used = sum(decisions(game, rally.own) for rally in seen)
    return Trained(player=respond(counted(setting.policy("bc"), seen), float(argument)), strokes=used)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Boosting:
    """Settings of ``model-boosted``, found by a search on dev: ``docs/suite/exploit.md``."""

    p: float = WEIGHT  # restriction of the response that is returned
    trees: int = 200
    leaves: int = 16
    most: int = 500_000  # own strokes of the play, at most


def model_boosted(setting: PlayerSetting, argument: str = "") -> Trained:
    """A model from play, and the restricted response in it (the argument is p), or without an opponent its solution."""
    tuned = next((found for most, found in BOOSTING.items() if setting.budget <= most), [*BOOSTING.values()][-1])
    estimate, used = estimated(setting, tuned)
    return Trained(player=in_game(planned(setting, estimate, float(argument or tuned.p)), setting.game), strokes=used)


def planned(setting: PlayerSetting, estimate: PairPolicy, p: float) -> TabulatedPolicy:
    """The response to an opponent in a model of the game, or without an opponent the solution of the model."""
    return respond(estimate, p if setting.opponent else 0.0)


def estimated(setting: PlayerSetting, options: Boosting) -> tuple[PairPolicy, int]:
    """The opponent in a model of the game, both estimated from play, and the strokes that were used.

    The play is at random at first, then as planned. Outcomes are boosted trees; with recovery, what positions change is added to
    their odds by shot type and area. The opponent is cloned by counts.
    """
    game, uniform, rules = setting.game, setting.policy("random"), blank(setting.game)
    player, logs, used, both = uniform, [], 0, setting.opponent is None
    fitting = {"objective": "multiclass", "num_class": len(OUTCOMES), "num_leaves": options.leaves, **_FITTING}
    for turn in range(2):
        # Own strokes, and with recovery positions; those of the other side too where that is the learner's.
        number = int(0.45 * min(setting.budget / (1 + game.hides) / (1 + both), options.most)) - _MARGIN
        log = play_log((player, player if both else setting.against), number, 2 * setting.seed + turn)
        used += sum(decisions(game, own) for own in (log.own, ~log.own)[: 1 + both])
        logs.append(log)
        pair, outcome, place, own, state = (
            np.concatenate([getattr(log, name) for log in logs]) for name in ("pair", "outcome", "waited", "own", "state")
        )
        trees = options.trees if turn else options.trees // 2  # a plan needs less than the result
        model = game_of(rules, boosted(rules, pair, outcome, trees, setting.seed, _COLUMNS, **fitting))
        model = with_positions(model, pair, outcome, place)
        estimate = PairPolicy(game=model, probability=cloned(rules, pair[~own], shrink=SHRINK))
        places = tilted_positions(estimate.position_probabilities(), model, state[own], place[own])
        estimate = estimate.waiting_at(places)
        if not turn:
            player = mixture([in_game(planned(setting, estimate, options.p), game), uniform], [1 - _EXPLORE, _EXPLORE])
    return estimate, used


BOOSTING: Final = {  # settings of `model-boosted` for budgets up to these, from the search on dev
    100_000: Boosting(trees=150, leaves=8),
    1_000_000: Boosting(),
    10_000_000: Boosting(trees=250, leaves=31, most=1_000_000),
}
TUNED: Final[dict[int, dict[str, Any]]] = {  # the same of `ppo-restricted`
    budget: {"own": 0.25, "batch": batch, "growth": 0.0, "epochs": 4, "minibatches": 4, "learning_rate": 3e-3}
    for budget, batch in ((100_000, 2048), (1_000_000, 4096), (10_000_000, 16_384))
}
_LONGER: Final = 1.6  # strokes of the first iteration over its batch, at most
_MORE: Final = 1.15  # margin of the strokes of an iteration over those of earlier ones
_LEAST: Final = 256  # strokes of the smallest batch
_ITERATIONS: Final = 12  # iterations of a run with a small budget, at least
_BLOCK: Final = 100  # rallies after which the opponents of a learner come again


def learner(setting: PlayerSetting, argument: str, own: float = 0.0, **options: Any) -> Trained:
    """The agent of a learning algorithm, in the game of the setting, which may be drawn.

    PPO (Schulman et al. 2017, arXiv 1707.06347), A2C (Mnih et al. 2016, arXiv 1602.01783), or SAC (Haarnoja et al. 2018, arXiv
    1801.01290) for discrete actions (Christodoulou 2019, arXiv 1910.07207).

    Args:
        own: fraction of the rallies against an opponent that are self-play.
        **options: of the configuration of the algorithm.
    """
    from shuttle_marl.base.pytorch import InitialWeights, own_settings  # noqa: PLC0415
    from shuttle_marl.training.config import CONFIGS  # noqa: PLC0415
    from shuttle_marl.training.networks import tabulated  # noqa: PLC0415
    from shuttle_marl.training.run import LEARNERS, tempered  # noqa: PLC0415
    from shuttle_marl.training.self_play import SelfPlayOpponents, n_opponents  # noqa: PLC0415

    game, budget, default = setting.game, setting.budget, CONFIGS[argument]
    options = {"batch": default().batch, **options}
    batch = min(options.pop("batch"), max(_LEAST, budget // _ITERATIONS))
    config = default(opponent=(setting.opponent or "self",), strokes=budget, batch=batch, seed=setting.seed, **options)
    config = tempered(config, game)
    with own_settings(config.threads):
        opponents = [setting.against] * (n_opponents(config) if config.self_play else 1)
        with InitialWeights(setting.seed):
            agent = LEARNERS[argument](config, game, opponents)
        changing = SelfPlayOpponents(config, game, agent)
        changing.set_seed(agent.collector.set_seed(setting.seed))
        if own:
            rallies = np.floor(own * np.arange(_BLOCK + 1))
            agent.collector.sampler.assign(np.where(np.diff(rallies) > 0, -1, 0))
        # Rallies are played to their end, so iterations are a little longer than their batches.
        longer: list[float] = []
        while agent.strokes + max(longer, default=_LONGER) * _MORE * (due := config.batch_of(agent.iteration)) < budget:
            changing.update(agent.iteration)
            before = agent.strokes
            agent.iterate(1 - before / budget)
            longer.append((agent.strokes - before) / due)
        return Trained(player=tabulated(agent.eval_actor, game, config.temperature), strokes=agent.strokes)


def ppo_variant(setting: PlayerSetting, argument: str) -> Trained:
    """PPO in a variant of self-play, see :mod:`shuttle_marl.training.self_play`."""
    return learner(setting, "ppo", variant=argument)


def ppo_restricted(setting: PlayerSetting, argument: str = "") -> Trained:
    """PPO whose rallies are partly self-play: a restricted response by rally, tuned at each budget on the dev split.

    ``experiments/results/suite_search.json`` has the search. The argument is the fraction of self-play.
    """
    tuned = next((found for most, found in TUNED.items() if setting.budget <= most), [*TUNED.values()][-1])
    return learner(setting, "ppo", **{**tuned, **({"own": float(argument)} if argument else {})})


def ppo_self_play(setting: PlayerSetting) -> Trained:
    """PPO in self-play, which does not look at the opponent."""
    return learner(dataclasses.replace(setting, opponent=None), "ppo")

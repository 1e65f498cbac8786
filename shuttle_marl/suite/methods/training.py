"""PPO, A2C, SAC and PSRO of :mod:`shuttle_marl.training`, with its default settings, against the opponent or in self-play.

They train in the game of a model, so not in the drawn game of a round.
"""

import dataclasses
import json
from typing import Any, Final

from shuttle_marl.base import runs
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.computed import best_response_policy
from shuttle_marl.policy.mixtures import deterministic, mixture
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.training.league.config import LeagueTrainingConfig

_SHARE: Final = 0.94
"""Fraction of the budget that is planned; the rest is for the ends of rallies, and for choices that are not the learner's."""
_LESS: Final = 0.97
"""Factor of the planned strokes until they fit."""
_SHARES: Final = {50_000: 0.5, 200_000: 0.65}
"""The same of budgets up to these: rallies become longer while a player learns, and few batches follow late."""
_ROUNDS: Final = 24
"""Rounds of exact PSRO."""
_BATCHES: Final = 100
"""Batches of PSRO in all rounds."""
_PHASES: Final = 4
"""Agents that are trained against a restricted opponent."""
_TURNS: Final = 6
"""Responses of fictitious self-play."""
_MIXED: Final = "mixed.npz"
_ITERATIONS: Final = 12
"""Iterations of a run with a small budget."""


def learner(setting: PlayerSetting, argument: str) -> Trained:
    """The agent of a learning algorithm.

    PPO (Schulman et al. 2017, arXiv 1707.06347), A2C (Mnih et al. 2016, arXiv 1602.01783), or SAC (Haarnoja et al. 2018, arXiv
    1801.01290) for discrete actions (Christodoulou 2019, arXiv 1910.07207).
    """
    return _trained(setting, argument)


def _trained(setting: PlayerSetting, algorithm: str = "ppo", **options: Any) -> Trained:
    """The agent of a learning algorithm, with options of its configuration."""
    from shuttle_marl.training import train  # noqa: PLC0415  torch
    from shuttle_marl.training.config import CONFIGS  # noqa: PLC0415

    if load_game(setting.model).hash != setting.game.hash:
        raise SuiteError(f"{algorithm} trains in the game of a model, and this game is drawn")
    default, folder = CONFIGS[algorithm], setting.folder / algorithm
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
        config = dataclasses.replace(config, strokes=int(config.strokes * _LESS))
    done = train(config)
    points = [json.loads(line) for line in (done.folder / runs.METRICS).read_text(encoding="utf-8").splitlines()]
    figure = "normalised_score" if setting.opponent is not None else "exploitability"
    curve = tuple((int(point["strokes"]), float(point[figure])) for point in points if point[figure] is not None)
    return Trained(player=done.policy, strokes=done.strokes, curve=curve)


def ppo_variant(setting: PlayerSetting, argument: str) -> Trained:
    """PPO in a variant of self-play, see :mod:`shuttle_marl.training.self_play`."""
    # Rallies that start in a state of the best response are of another length, so more strokes are kept back.
    planned = dataclasses.replace(setting, budget=setting.budget * 49 // 50) if argument == "restarts" else setting
    return _trained(planned, variant=argument)


def ppo_self_play(setting: PlayerSetting) -> Trained:
    """PPO in self-play, which does not look at the opponent."""
    return _trained(dataclasses.replace(setting, opponent=None))


def ppo_deterministic(setting: PlayerSetting) -> Trained:
    """PPO in self-play, whose agent always makes its likeliest choice."""
    found = _trained(setting)
    return dataclasses.replace(found, player=deterministic(tabulate(found.player, setting.game)), curve=())


def ppo_restricted(setting: PlayerSetting) -> Trained:
    """PPO against the opponent of the objective: the given one, mixed with exact best responses to the agents before.

    Each of the phases trains a new agent against one more enemy; the last one is played (Johanson, Zinkevich & Bowling, NeurIPS
    2007, by iteration as in fictitious play).
    """
    used, enemies = 0, list[TabulatedPolicy]()
    opponent: str | TabulatedPolicy | None = setting.opponent
    for phase in range(_PHASES):
        player, strokes = _part(setting, str(phase), opponent, setting.budget // _PHASES)
        used += strokes
        enemies.append(best_response_policy(player))
        shares = [(1 - WEIGHT) / len(enemies)] * len(enemies)
        opponent = mixture([setting.against, *enemies], [WEIGHT, *shares])
    return Trained(player=player, strokes=used)


def fictitious_self_play(setting: PlayerSetting) -> Trained:
    """Fictitious self-play (Heinrich, Lanctot & Silver, ICML 2015): PPO learns responses to the mean of those before.

    The mean is taken choice by choice, and its strokes count as well.
    """
    mean, used = setting.policy("random"), 0
    for turn in range(_TURNS):
        player, strokes = _part(setting, str(turn), mean, setting.budget // (2 * _TURNS))
        used += 2 * strokes
        mean = mixture([mean, player], [turn / (turn + 1), 1 / (turn + 1)])
    return Trained(player=mean, strokes=used)


def psro(setting: PlayerSetting) -> Trained:
    """Policy space response oracles (Lanctot et al. 2017, arXiv 1711.00832); PPO learns the responses."""
    # Rallies are played to their end, so turns are a little longer than their batches.
    size = setting.budget // _BATCHES
    return _league(setting, LeagueTrainingConfig(variant="psro", oracle="ppo", strokes=int(0.85 * setting.budget), batch=size))


def psro_exact(setting: PlayerSetting) -> Trained:
    """The same with exact best responses, which use no strokes: a double oracle."""
    return _league(setting, LeagueTrainingConfig(variant="psro", oracle="exact", rounds=_ROUNDS))


def _league(setting: PlayerSetting, config: LeagueTrainingConfig) -> Trained:
    from shuttle_marl.training.league.run import MAIN, train_league  # noqa: PLC0415  torch

    folder = setting.folder / "league"
    resume = (folder / runs.CONFIG).exists()
    done = train_league(
        dataclasses.replace(config, seed=setting.seed, game=setting.model, record="none", workers=1, out=folder, resume=resume)
    )
    return Trained(player=f"table:{done.folder / MAIN}", strokes=done.figures["strokes"])


def _part(setting: PlayerSetting, name: str, opponent: str | TabulatedPolicy | None, budget: int) -> tuple[TabulatedPolicy, int]:
    """An agent of PPO that is a part of a method, and the strokes that it used; ``opponent`` as in a setting, or a table."""
    if isinstance(opponent, TabulatedPolicy):
        opponent.save(setting.folder / _MIXED)
        opponent = f"table:{setting.folder / _MIXED}"
    found = _trained(dataclasses.replace(setting, opponent=opponent, budget=budget, folder=setting.folder / name))
    return tabulate(found.player, setting.game), found.strokes or 0

"""PPO, A2C and SAC of :mod:`shuttle_marl.training`, with its default settings, against the opponent or in self-play.

They train in the game of a model, so not in the drawn game of a round.
"""

import dataclasses
import json
from typing import Any, Final

from shuttle_marl.base import runs
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.computed import deterministic
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.options import SuiteError

_SHARE: Final = 0.94
"""Fraction of the budget that is planned; the rest is for the ends of rallies, and for choices that are not the learner's."""
_LESS: Final = 0.97
"""Factor of the planned strokes until they fit."""
_SHARES: Final = {50_000: 0.5, 200_000: 0.65}
"""The same of budgets up to these: rallies become longer while a player learns, and few batches follow late."""
_ITERATIONS: Final = 12
"""Iterations of a run with a small budget."""


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
    return learner(planned, "ppo", variant=argument)


def ppo_self_play(setting: PlayerSetting) -> Trained:
    """PPO in self-play, which does not look at the opponent."""
    return learner(dataclasses.replace(setting, opponent=None), "ppo")


def ppo_deterministic(setting: PlayerSetting) -> Trained:
    """PPO in self-play, whose agent always makes its likeliest choice."""
    found = learner(setting, "ppo")
    return dataclasses.replace(found, player=deterministic(tabulate(found.player, setting.game)), curve=())

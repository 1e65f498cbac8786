"""The imitator: predicts the next stroke of a player from everything that is visible at the hit.

The behaviour-cloned players of the game (``bc``) know the state of the game only. The imitator also reads positions, tempo, four
previous strokes and the players (:mod:`experiments.imitation.context`); it predicts people better and cannot play the game. The
prediction is the mean of networks (:mod:`experiments.imitation.networks`) and boosted trees (:mod:`experiments.imitation.trees`),
whose errors differ. Contact heights and players are hidden in part of the training strokes, so one model predicts with and
without them, and treats unknown players as an average player.

    imitator = Imitator.fit(load_strokes("train.parquet"))
    probability = imitator.predict(load_strokes("new.parquet"))  # [N, 13, 9]
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import pyarrow as pa
import torch

from experiments.imitation.context import HitContexts, hit_contexts
from experiments.imitation.networks import ImitatorNetworks, NetworksConfig, TrainingStrokes, one_thread
from experiments.imitation.trees import ImitatorTrees, TreesConfig
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes

WORKERS: Final = 2
"""Parts fitted at the same time, each in one thread: another order of summation would give other weights."""
TREES_WEIGHT: Final = 0.5
"""Weight of the trees in the mean. On held-out matches of the training split, weights of .4 to .6 are equally good."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImitatorConfig:
    """Settings of the fit.

    Attributes:
        networks: of the networks.
        trees: of the trees.
    """

    networks: NetworksConfig = dataclasses.field(default_factory=NetworksConfig)
    trees: TreesConfig = dataclasses.field(default_factory=TreesConfig)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Imitator:
    """A fitted imitator.

    Attributes:
        players: identifiers of the known players; all others are treated as the average player.
        config: settings of the fit.
        networks, trees: the two models whose predictions are averaged.
    """

    players: tuple[str, ...]
    config: ImitatorConfig
    networks: ImitatorNetworks
    trees: ImitatorTrees

    @classmethod
    def fit(
        cls,
        strokes: pa.Table,
        *,
        config: ImitatorConfig | None = None,
        seed: int = 0,
        report: Callable[[str], None] = lambda _: None,
    ) -> "Imitator":
        """Fit an imitator; two to three minutes of CPU time for 50,000 strokes, on up to two cores.

        The intended area of a fault is unknown, so faults only teach the shot type. The area of a winner is the one in which a
        receiver would have met the shuttle (:mod:`shuttle_marl.dynamics.features`).

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`.
            config: settings.
            seed: random seed; equal seeds give equal weights and trees.
            report: called with a line before each part.

        Raises:
            ShuttleError: no stroke in the table has a known area.
        """
        if not strokes.num_rows:
            raise ShuttleError("no stroke to learn from; is the data complete?")
        config = config or ImitatorConfig()
        contexts, rows = hit_contexts(strokes), rows_from_strokes(strokes)
        players = tuple(sorted({*contexts.striker.tolist(), *contexts.receiver.tolist()}))
        codes = _player_codes(players, contexts)
        shot = rows.codes["shot"].astype(np.int64)
        area = np.where(rows.outcome == Outcome.FAULT, -1, rows.codes["area"]).astype(np.int64)
        if (area < 0).all():
            raise ShuttleError("no stroke whose area is known to learn from; is the data complete?")
        networks = ImitatorNetworks.untrained(contexts, len(players), config.networks, seed)
        training = TrainingStrokes(*networks.inputs(contexts, codes), torch.from_numpy(shot), torch.from_numpy(area))

        def fit_trees() -> ImitatorTrees:
            report("imitator, trees")
            return ImitatorTrees.fit(contexts, codes, shot, area, config=config.trees, seed=seed)

        def train(member: int) -> None:
            report(f"imitator, network {member + 1} of {config.networks.members}")
            networks.train(member, 1000 * seed + member, training)

        with one_thread(), ThreadPoolExecutor(WORKERS) as pool:
            trees = pool.submit(fit_trees)
            list(pool.map(train, range(config.networks.members)))
        networks.members.requires_grad_(False).eval()
        return cls(players=players, config=config, networks=networks, trees=trees.result())

    def predict(self, strokes: pa.Table, *, height_known: bool = True, striker: str | None = None) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area, for every stroke of a table.

        A prediction depends on nothing after the hit: neither on the stroke, its outcome and its landing, nor on later rows.

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, whole rallies.
            height_known: whether predictions may depend on the contact height.
            striker: predict every stroke as if this player struck it; an unknown name means the average player.
        """
        contexts = hit_contexts(strokes)
        if not height_known:
            contexts = contexts.without_height()
        if striker is not None:
            contexts = dataclasses.replace(contexts, striker=np.full(len(contexts), striker))
        codes = _player_codes(self.players, contexts)
        of_trees, of_networks = self.trees.predict(contexts, codes), self.networks.predict(contexts, codes)
        return TREES_WEIGHT * of_trees + (1 - TREES_WEIGHT) * of_networks


def _player_codes(players: tuple[str, ...], contexts: HitContexts) -> I64:
    """``[N, 2]`` code of striker and receiver: position among the players, from 1; 0 for unknown players."""
    code = {player: i for i, player in enumerate(players, start=1)}
    codes = [[code.get(name, 0) for name in names.tolist()] for names in (contexts.striker, contexts.receiver)]
    return np.array(codes, dtype=np.int64).reshape(2, -1).T

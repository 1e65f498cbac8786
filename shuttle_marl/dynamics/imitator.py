"""The imitator: what a player will do next, from all that can be seen at the moment of the hit.

The players of the game (``bc``) know the state of the game only. The imitator reads positions, tempo, four strokes and the
players as well (:mod:`shuttle_marl.dynamics.moments`), so it predicts people better and cannot play the game. Networks
(:mod:`shuttle_marl.dynamics.imitator_networks`) and boosted trees (:mod:`shuttle_marl.dynamics.imitator_trees`) give the shot
type, and the area given the shot type. They err differently, and the prediction is the mean of both. During the fit the contact
height and each player are hidden now and then, so one model answers with and without them, and knows an average player for
those it never saw.

    imitator = Imitator.fit(load_strokes("train.parquet"))
    probability = imitator.predict(load_strokes("new.parquet"))  # [N, 13, 9]
"""

import dataclasses
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import torch
from safetensors.numpy import save

from shuttle_marl.arrays import F64, I64
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.dynamics.fitted import ModelError
from shuttle_marl.dynamics.imitator_networks import ImitatorNetworks, NetworksConfig, one_thread
from shuttle_marl.dynamics.imitator_trees import ImitatorTrees, TreesConfig
from shuttle_marl.dynamics.moments import Moments, moments_of
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.tensor_files import parsed, read_tensors

WORKERS: Final = 2
"""Parts that are fitted at the same time, each in one thread: sums in another order would give other weights."""
TREES_SHARE: Final = 0.5
"""Weight of the trees in the mean. On matches left out of the training matches .4 to .6 do as well."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImitatorConfig:
    """Settings of the fit.

    Attributes:
        networks: of the networks.
        trees: of the trees.
    """

    networks: NetworksConfig = dataclasses.field(default_factory=NetworksConfig)
    trees: TreesConfig = dataclasses.field(default_factory=TreesConfig)


def _silent(line: str) -> None:
    del line


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Imitator:
    """A fitted imitator.

    Attributes:
        players: identifiers of the players that it knows; everyone else is the average player.
        config: of the fit.
        networks, trees: its two halves.
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
        report: Callable[[str], None] = _silent,
    ) -> "Imitator":
        """Fit an imitator; two to three minutes of one core's time for 50,000 strokes, of which two may share.

        The area of a fault does not say where it was aimed, so faults teach the shot type alone. That of a winner is the one in
        which a receiver would have met it (:mod:`shuttle_marl.dynamics.landings`).

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`.
            config: settings.
            seed: of all random numbers; the same seed gives the same weights and trees.
            report: called with a line before each part.

        Raises:
            ShuttleError: a table without strokes of a known area, or LightGBM is not installed.
        """
        if not strokes.num_rows:
            raise ShuttleError("no stroke to learn from; is the data complete?")
        config = config or ImitatorConfig()
        moments, rows = moments_of(strokes), rows_from_strokes(strokes)
        players = tuple(sorted({*moments.striker.tolist(), *moments.receiver.tolist()}))
        who = _codes(players, moments)
        shot = rows.codes["shot"].astype(np.int64)
        area = np.where(rows.outcome == Outcome.FAULT, -1, rows.codes["area"]).astype(np.int64)
        if (area < 0).all():
            raise ShuttleError("no stroke whose area is known to learn from; is the data complete?")
        networks = ImitatorNetworks.untrained(moments, len(players), config.networks, seed)
        inputs = (*networks.inputs(moments, who), torch.from_numpy(shot), torch.from_numpy(area))

        def fit_trees() -> ImitatorTrees:
            report("imitator, trees")
            return ImitatorTrees.fit(moments, who, shot, area, config.trees, seed)

        def train(member: int) -> None:
            report(f"imitator, network {member + 1} of {config.networks.members}")
            networks.train(member, 1000 * seed + member, *inputs)

        with one_thread(), ThreadPoolExecutor(WORKERS) as pool:
            trees = pool.submit(fit_trees)
            list(pool.map(train, range(config.networks.members)))
        networks.members.requires_grad_(False).eval()
        return cls(players=players, config=config, networks=networks, trees=trees.result())

    def predict(self, strokes: pa.Table, *, height_known: bool = True, striker: str | None = None) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area, for every stroke of a table.

        Nothing after the hit is read: outcome, landing and shot type of a stroke change nothing, nor do later rows.

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, whole rallies.
            height_known: whether the height at which the shuttle is met may be read.
            striker: play every stroke as this player would; an unknown name means the average player.
        """
        moments = moments_of(strokes)
        if not height_known:
            moments = moments.without_height()
        if striker is not None:
            moments = dataclasses.replace(moments, striker=np.full(len(moments), striker))
        who = _codes(self.players, moments)
        of_trees, of_networks = self.trees.predict(moments, who), self.networks.predict(moments, who)
        return TREES_SHARE * of_trees + (1 - TREES_SHARE) * of_networks

    def save(self, path: Path) -> None:
        """Write a safetensors file.

        Raises:
            FileWriteError: the file cannot be written.
        """
        halves = {"networks": self.networks.arrays(), "trees": self.trees.arrays()}
        arrays = {f"{half}.{name}": np.ascontiguousarray(array) for half, part in halves.items() for name, array in part.items()}
        described = {"config": dataclasses.asdict(self.config), "players": self.players}
        # One entry only: safetensors writes several in no fixed order, and the same fit must give the same file.
        replace_file(path, save(arrays, metadata={"imitator": json.dumps(described, sort_keys=True)}))

    @classmethod
    def load(cls, path: Path) -> "Imitator":
        """Read a file written by :meth:`save`.

        Raises:
            ModelError: there is no such file, or it holds no imitator.
        """
        try:
            header, arrays = read_tensors(path)
            described = parsed(header["imitator"])
            settings = described["config"]
            config = ImitatorConfig(networks=NetworksConfig(**settings["networks"]), trees=TreesConfig(**settings["trees"]))
            players = tuple(map(str, described["players"]))
            networks = ImitatorNetworks.checked(_part("networks.", arrays), len(players), config.networks)
            trees = ImitatorTrees.checked(_part("trees.", arrays), len(networks.mean))
            return cls(players=players, config=config, networks=networks, trees=trees)
        except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError, IndexError) as error:
            raise ModelError(f"{path}: no readable imitator ({error}); fit it again") from error


def _part(prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _codes(players: tuple[str, ...], moments: Moments) -> I64:
    """``[N, 2]`` position of striker and receiver among the players, from 1; 0 for everyone else."""
    position = {player: i for i, player in enumerate(players, start=1)}
    who = [[position.get(name, 0) for name in names.tolist()] for names in (moments.striker, moments.receiver)]
    return np.array(who, dtype=np.int64).reshape(2, -1).T

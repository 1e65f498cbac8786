"""The trees of the imitator: boosted trees over the same moments as its networks, from which they err differently.

Everything that they read is a small whole number with an order: codes as they are, and each number as its step on a quantile
scale. One set of trees says the shot type, another one the area given the shot type. During the fit the contact height and each
player are hidden in a share of the strokes, as from the networks.
"""

import dataclasses
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from shuttle_marl.arrays import F32, F64, I16, I64
from shuttle_marl.dynamics.moments import CODES, UNSEEN_HEIGHT, Moments, cuts_of, steps_of
from shuttle_marl.dynamics.trees import OrderedTrees, fit_ordered_trees
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.tensor_files import checked

STEPS: Final = 64
"""Steps of the quantile scale of each number."""
_HEIGHT: Final = list(CODES).index("height")
_PLAYERS: Final = len(CODES)
"""Column of the striker; that of the receiver follows, and then the steps."""
_CHUNK: Final = 4096


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreesConfig:
    """Settings of the fit; chosen on matches left out of the training matches.

    Attributes:
        type_rounds: trees of each shot type.
        area_rounds: trees of each area.
        leaves: greatest number of leaves of a tree.
        rate: share of each step that is taken.
        columns: share of the columns that a tree may read, drawn for each.
        hide_height: share of strokes whose contact height is hidden during the fit.
        hide_player: share of strokes whose striker is hidden during the fit, and share of those whose receiver is.
    """

    type_rounds: int = 130
    area_rounds: int = 130
    leaves: int = 15
    rate: float = 0.08
    columns: float = 0.5
    hide_height: float = 0.5
    hide_player: float = 0.1


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImitatorTrees:
    """Fitted trees.

    Attributes:
        cuts: ``[F, 63]`` rising, between the steps of the quantile scale of each number.
        types: of the shot type.
        areas: of the area; the last column that they read is the shot type.
    """

    cuts: F32
    types: OrderedTrees
    areas: OrderedTrees

    @classmethod
    def fit(
        cls,
        moments: Moments,
        who: I64,
        shot: I64,
        area: I64,
        config: TreesConfig,
        seed: int,
    ) -> Self:
        """Fit trees.

        Args:
            moments: of N strokes.
            who: ``[N, 2]`` codes of striker and receiver, 0 for the average player.
            shot: ``[N]`` shot types.
            area: ``[N]`` areas, -1 where that is not known.
            config: settings.
            seed: of all random numbers.
        """
        cuts = cuts_of(moments.numbers, STEPS)
        columns = _columns(moments, who, cuts)
        draws = np.random.default_rng(seed).random((len(columns), 3))
        columns[draws[:, 0] < config.hide_height, _HEIGHT] = UNSEEN_HEIGHT
        columns[:, _PLAYERS : _PLAYERS + 2][draws[:, 1:] < config.hide_player] = 0
        settings: dict[str, Any] = {
            "leaves": config.leaves, "rate": config.rate, "features": config.columns, "seed": seed
        }  # fmt: skip
        aimed = np.column_stack([columns, shot.astype(np.int16)])[area >= 0]
        return cls(
            cuts=cuts,
            types=fit_ordered_trees(columns, shot, N_SHOTS, rounds=config.type_rounds, **settings),
            areas=fit_ordered_trees(aimed, area[area >= 0], N_AREAS, rounds=config.area_rounds, **settings),
        )

    def predict(self, moments: Moments, who: I64) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area; ``who`` as in :meth:`fit`."""
        columns = _columns(moments, who, self.cuts)
        out = np.empty((len(columns), N_SHOTS, N_AREAS))
        for start in range(0, len(columns), _CHUNK):
            part = columns[start : start + _CHUNK]
            types = softmax(self.types.sums(part, N_SHOTS), axis=1)
            every = np.tile(np.arange(N_SHOTS, dtype=np.int16), len(part))
            areas = self.areas.sums(np.column_stack([np.repeat(part, N_SHOTS, axis=0), every]), N_AREAS)
            out[start : start + _CHUNK] = types[:, :, None] * softmax(areas, axis=1).reshape(-1, N_SHOTS, N_AREAS)
        return out

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays of a file, by name."""
        named = {"types": self.types, "areas": self.areas}
        return {
            "cuts": self.cuts,
            **{f"{name}.{key}": array for name, trees in named.items() for key, array in vars(trees).items()},
        }

    @classmethod
    def checked(cls, arrays: dict[str, npt.NDArray[Any]], numbers: int) -> Self:
        """Trees of arrays from a file, over moments of so many numbers.

        Raises:
            KeyError, ValueError: they are none.
        """
        width = _PLAYERS + 2 + numbers
        types, areas = (
            OrderedTrees.checked({key: arrays[f"{name}.{key}"] for key in ("attribute", "left", "child", "value")}, read)
            for name, read in (("types", width), ("areas", width + 1))
        )
        return cls(cuts=checked(arrays["cuts"], np.float32, (numbers, STEPS - 1)), types=types, areas=areas)


def _columns(moments: Moments, who: I64, cuts: F32) -> I16:
    """``[N, 20 + F]`` codes that have an order."""
    return np.concatenate([moments.codes, who, steps_of(moments.numbers, cuts)], axis=1).astype(np.int16)

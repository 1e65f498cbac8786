"""``bc:history``: the imitated average player who remembers the rally, for simulated matches that look real.

A state holds the incoming stroke and the striker's own last one. People also remember the two strokes before, attack less in long
rallies, and lift less at the end of close games. Attributes of these strokes, the number of the stroke and, in a match, the score
shift the log-probabilities of ``bc``: of a shot type and technique, and of an area given those. Fitted by
:mod:`shuttle_marl.dynamics.choices`, run without torch.

The policy is no stronger opponent than ``bc`` and forecasts no better. It is no function of the state, so it has no table.
"""

import dataclasses
import functools
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I32
from shuttle_marl.base.tensor_files import checked
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.policy import LAGS, STAGES, PolicyError, States, TabulatedPolicy, stages_of
from shuttle_marl.game.shipped import HISTORY, folder_of, read_model
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines

NAME: Final = "bc:history"
N_STYLES: Final = N_SHOTS * N_TECHNIQUES
"""Pairs of shot type and technique."""
ATTRIBUTES: Final = {"shot": N_SHOTS, "area": N_AREAS, "technique": N_TECHNIQUES}
"""Attributes of a remembered stroke, and their numbers of values; one more value stands for no stroke."""
_WIDTH: Final = N_STYLES + N_AREAS
FIRST_LAG: Final = 2
"""First column of ``States.history`` that the state does not hold."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HistoryPolicy:
    """A player of the state whose log-probabilities are shifted by earlier strokes of the rally.

    Attributes:
        base: the player of the state.
        shifts: of each shot type and technique, and of each area: by attribute (:data:`ATTRIBUTES`)
            ``[2, values + 1, 39 + 9]`` by lag (3 and 4) and value; by kind of stage (:data:`~shuttle_marl.game.policy.STAGES`)
            ``[stages, 39 + 9]``.
    """

    base: TabulatedPolicy
    shifts: dict[str, F64]
    reads_history = True
    limits_itself = True

    @classmethod
    def of(cls, base: TabulatedPolicy, arrays: dict[str, npt.NDArray[Any]]) -> "HistoryPolicy":
        """A policy from the arrays of a file.

        Raises:
            KeyError, ValueError: an array is missing or invalid.
        """
        shapes: dict[str, tuple[int, ...]] = {name: (size, _WIDTH) for name, size in STAGES.items()}
        shapes |= {name: (LAGS - FIRST_LAG, size + 1, _WIDTH) for name, size in ATTRIBUTES.items()}
        shifts = {name: checked(arrays[name], np.float16, shape).astype(np.float64) for name, shape in shapes.items()}
        return cls(base=base, shifts=shifts)

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probability of each stroke; see :class:`shuttle_marl.game.policy.Policy`.

        Raises:
            ValueError: the states have no history.
        """
        if states.history is None:
            raise ValueError("states without history")
        catalogue, p = states.game.catalogue, self.base.probabilities(states)
        factor = np.exp(self._shift(states, states.history[:, FIRST_LAG:]))
        style, of_stroke = np.unique(catalogue.shot.astype(np.int64) * N_TECHNIQUES + catalogue.technique, return_inverse=True)
        order = np.argsort(of_stroke, kind="stable")
        start = np.searchsorted(of_stroke[order], np.arange(len(style)))
        # An area is chosen given shot type and technique: its shifts leave their probabilities as they are.
        q = p * factor.take(N_STYLES + catalogue.area, axis=1)
        before, after = (np.add.reduceat(x.take(order, axis=1), start, axis=1) for x in (p, q))
        factor = factor.take(style, axis=1) * np.divide(before, after, out=np.zeros_like(after), where=after > 0)
        q *= factor.take(of_stroke, axis=1)
        return np.asarray(q / q.sum(axis=1, keepdims=True))

    def _shift(self, states: States, strokes: I32) -> F64:
        """``[B, 39 + 9]`` shifts by ``[B, 2]`` earlier strokes, n for none, and by the stages that are known."""
        lag, catalogue = np.arange(strokes.shape[1]), states.game.catalogue
        values = {name: np.append(getattr(catalogue, name), size)[strokes] for name, size in ATTRIBUTES.items()}
        shift = sum(self.shifts[name][lag, value].sum(axis=1) for name, value in values.items())
        stages = stages_of(states.number, None if states.score is None else states.score[:, :2])
        return np.asarray(shift + sum(np.pad(self.shifts[name], ((0, 1), (0, 0)))[stage] for name, stage in stages.items()))


def known_for(game: Game) -> bool:
    """Whether the model of a game knows choices by the rally so far."""
    folder = folder_of(game)
    return baselines.known_for(game) and folder is not None and (folder / HISTORY).is_file()


@functools.lru_cache(maxsize=8)
def load(game: Game) -> HistoryPolicy:
    """The average player of a game who remembers the rally.

    Raises:
        PolicyError: the model of the game has none, or its file is damaged.
    """
    base, folder = baselines.load(None, game), folder_of(game)
    if folder is None or not known_for(game):
        raise PolicyError(f"policy {NAME}: the model of this game has no {HISTORY}; fit the model again, or use bc")
    try:
        return HistoryPolicy.of(base, read_model(folder, HISTORY).arrays)
    except GameError as error:
        raise PolicyError(str(error)) from error
    except (OSError, KeyError, ValueError) as error:
        raise PolicyError(f"{folder / HISTORY}: no readable choices ({error}); fit or install the model again") from error

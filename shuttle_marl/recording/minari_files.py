"""Logs as Minari data sets (extra ``minari``): the single-agent view, one episode for each rally with an own stroke.

Observations are those of ``shuttle_marl/Rally-v0``, with the mask of legal strokes. A reward is 1 for the last own stroke of a
rally that was won. Infos hold the state of the game and the probability of the stroke under the behaviour policy. The
observation after the last stroke is zero, because the rally is over.
"""

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from unittest import mock

import gymnasium
import numpy as np

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.game.layout import observations
from shuttle_marl.recording.logs import Transitions

ENVIRONMENT: Final = "shuttle_marl:shuttle_marl/Rally-v0"


def write_minari(data: Transitions, name: str, folder: Path, model: str, opponent: str) -> None:
    """Write a data set.

    Args:
        name: id of the data set, such as ``shuttle_marl/offline-bc-v0``.
        folder: of the data sets, as in the environment variable ``MINARI_DATASETS_PATH``.
        model, opponent: names of the game and of the opponent, for the environment of the data set.

    Raises:
        ShuttleError: Minari is not installed, or the data set exists.
    """
    try:
        import minari  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise ShuttleError(f"Minari is not installed; {install_hint('minari')}") from error
    env = gymnasium.make(ENVIRONMENT, opponent=opponent, game=model)
    with warnings.catch_warnings(), mock.patch.dict(os.environ, {"MINARI_DATASETS_PATH": str(folder.resolve())}):
        warnings.simplefilter("ignore", UserWarning)  # optional metadata are missing
        try:
            minari.create_dataset_from_buffers(name, list(episodes(data)), env=env)
        except ValueError as error:
            raise ShuttleError(f"{folder}: {error}") from error


def episodes(data: Transitions) -> Iterator[Any]:
    """Each rally as an episode."""
    from minari.data_collector import EpisodeBuffer  # noqa: PLC0415  an extra

    seen, mask = observations(data.game, data.state), data.game.mask(data.state).astype(np.int8)
    for rows in np.split(np.arange(len(data)), np.flatnonzero(data.first)[1:]):
        last = rows == rows[-1]
        yield EpisodeBuffer(
            observations={
                "observation": np.pad(seen[rows], ((0, 1), (0, 0))),
                "action_mask": np.pad(mask[rows], ((0, 1), (0, 0))),
            },
            actions=data.stroke[rows].astype(np.int64),
            rewards=data.reward[rows],
            terminations=last,
            truncations=np.zeros_like(last),
            infos={
                "state": np.append(data.state[rows], -1)[:, None],
                "probability": np.append(data.probability[rows], np.float32(np.nan))[:, None],
            },
        )

"""One rally between two players, as a PettingZoo AEC environment; ``match_v0`` plays matches of such rallies."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from shuttle_marl.base.errors import OptionError, suggesting
from shuttle_marl.env.aec import METADATA, OutcomesFrom, RenderMode, ShuttleEnv
from shuttle_marl.env.wrappers import ActionView, CheckedEnv, InfoView, MaskView, PlainEnv, without_parallel, wrapped
from shuttle_marl.game.rally import RallyDraws
from shuttle_marl.game.tables import Game

__all__ = ["env", "raw_env"]


def env(
    *, action: ActionView = "flat", mask: MaskView = "observation", info: InfoView | None = None, **kwargs: Any
) -> CheckedEnv | PlainEnv:
    """The environment with PettingZoo's checks; an illegal stroke loses the rally.

    Args:
        action: ``flat``: catalogue index, ``Discrete(n)``; ``components``: shot type, area, height and technique,
            ``MultiDiscrete([13, 9, 2, 3])``.
        mask: place of the mask: ``observation`` (in the dictionary of the observation), ``info`` (``info["action_mask"]``) or
            ``none``. Observations are plain vectors with the last two.
        info: ``full``: last stroke and result, with text and None; ``none``: numbers only. Default: full with
            ``mask="observation"``, else none.
        **kwargs: arguments of :class:`raw_env`.

    Raises:
        OptionError: an invalid option.
    """
    return wrapped(raw_env(**kwargs), action, mask, info)


@suggesting
class raw_env(ShuttleEnv):
    """One rally, with reward +1 for the winner and -1 for the loser at its end.

    Args:
        server: server, 0 or 1; None: random.
        game: the tables, the game of a pair, or a model by name or folder (``default:men``); None: the default game.
        outcomes: ``tables``; or ``models``: the PyTorch modules of the model decide, which is slower and the same game.
        max_strokes: maximum number of strokes, after which the rally is truncated; None: no limit.
        render_mode: ``human``, ``rgb_array``, ``ansi``, or None.
        record: file for a log of every rally (:class:`shuttle_marl.env.recorded.Recording`), such as rallies.mcap; None: no log.
        history: number K of the last strokes of each player that observations have too, see
            :func:`shuttle_marl.env.history.features_of`: 54 K numbers, in front of the last number of the game with recovery.

    Raises:
        OptionError: an invalid option.
        GameError: the model does not exist.
        RecordingError: the log exists or cannot be created.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "rally_v0", **METADATA}

    def __init__(
        self,
        *,
        server: Literal[0, 1] | None = None,
        game: Game | str | None = None,
        outcomes: OutcomesFrom = "tables",
        max_strokes: int | None = None,
        render_mode: RenderMode | None = None,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        options: Any = {"render_mode": render_mode, "record": record, "history": history}
        super().__init__(game=game, outcomes=outcomes, max_strokes=max_strokes, **options, extra_width=0)
        if isinstance(server, float) or server not in (None, 0, 1):
            raise OptionError(f"server {server!r}: expected 0, 1, or None for a random server")
        self.server = server

    def _begin_episode(self) -> int:
        if self.episode == 0:
            self._draws = self._draws_of_episode()
        self._rally = self.episode
        return self._draws.first_server(self._rally) if self.server is None else self.server

    def _draws_of_episode(self) -> RallyDraws:
        assert self.last_seed is not None
        return RallyDraws(self.last_seed)


if not TYPE_CHECKING:  # a type checker would take every name for one of this module
    __getattr__ = without_parallel(__name__, __all__)

"""One rally between two players, as a PettingZoo AEC environment."""

from typing import Any, ClassVar, Literal

from shuttle_marl.env.base import RENDER_MODES, OptionError, RenderMode, ShuttleEnv
from shuttle_marl.env.episode_draws import EpisodeDraws
from shuttle_marl.env.wrappers import ActionView, CheckedEnv, wrapped
from shuttle_marl.game.rally import Game

__all__ = ["env", "raw_env"]


def env(*, action: ActionView = "flat", **kwargs: Any) -> CheckedEnv:
    """The environment with PettingZoo's checks; an illegal stroke loses the rally.

    Args:
        action: ``flat``: catalogue index, ``Discrete(n)``; ``components``: shot type, area, height and technique,
            ``MultiDiscrete([13, 9, 2, 3])``.
        **kwargs: those of :class:`raw_env`.
    """
    return wrapped(raw_env(**kwargs), action)


class raw_env(ShuttleEnv):
    """One rally: +1 for who wins it, -1 for the other, at its end.

    Args:
        server: who serves, 0 or 1; None: by lot, seeded.
        game: the tables, or a model by name or folder; None: the benchmark's.
        max_strokes: strokes after which a rally is cut off (truncated); None: never.
        render_mode: ``human``, ``rgb_array``, ``ansi``, or None.

    Raises:
        OptionError: an option that is not among those.
        GameError: there is no such model.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "rally_v0",
        "render_modes": list(RENDER_MODES),
        "is_parallelizable": False,
        "render_fps": 2,
    }

    def __init__(
        self,
        *,
        server: Literal[0, 1] | None = None,
        game: Game | str | None = None,
        max_strokes: int | None = None,
        render_mode: RenderMode | None = None,
    ) -> None:
        super().__init__(game=game, max_strokes=max_strokes, render_mode=render_mode, extra_width=0)
        if server not in (None, 0, 1):
            raise OptionError(f"server {server!r}: expected 0, 1, or None for a draw by lot")
        self.server = server

    def _begin_episode(self) -> int:
        assert self.last_seed is not None
        if self.episode == 0:
            self._source = EpisodeDraws(self.last_seed)
        self._rally = self.episode
        return self._source.first_server(self._rally) if self.server is None else self.server

    def _end_rally(self, winner: int) -> None:
        self._end_episode(winner)

    def _title(self) -> str:
        return f"rally {self.episode + 1} of seed {self.last_seed}"

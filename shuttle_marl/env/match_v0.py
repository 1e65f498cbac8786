"""A match between two players, as a PettingZoo AEC environment."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from shuttle_marl.base.arrays import F32
from shuttle_marl.base.errors import OptionError, suggesting
from shuttle_marl.env.aec import AGENTS, METADATA, OutcomesFrom, RenderMode, ShuttleEnv
from shuttle_marl.env.wrappers import ActionView, CheckedEnv, InfoView, MaskView, PlainEnv, without_parallel, wrapped
from shuttle_marl.game.layout import RALLY_WIDTH, SCORE_WIDTH
from shuttle_marl.game.rally import RallyDraws
from shuttle_marl.game.scoring import BWF, Rules, Score, score_fractions
from shuttle_marl.game.tables import Game

__all__ = ["env", "raw_env"]


def env(
    *, action: ActionView = "flat", mask: MaskView = "observation", info: InfoView | None = None, **kwargs: Any
) -> CheckedEnv | PlainEnv:
    """The environment with PettingZoo's checks, as :func:`shuttle_marl.env.rally_v0.env`; an illegal stroke loses the match."""
    return wrapped(raw_env(**kwargs), action, mask, info)


@suggesting
class raw_env(ShuttleEnv):
    """A match: best of three games to 21; the winner of a rally serves next.

    Args:
        first_server: first server, 0 or 1; None: random.
        reward: ``match``: +1 and -1 at the end of the match; ``rally``: +1 and -1 at the end of every rally.
        max_strokes: maximum number of strokes, after which the match is truncated; None: no limit.
        game, outcomes, render_mode, record, history: as of :class:`shuttle_marl.env.rally_v0.raw_env`.

    Raises:
        OptionError: an invalid option.
        GameError: the model does not exist.
        RecordingError: the log exists or cannot be created.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "match_v0", **METADATA}

    def __init__(
        self,
        *,
        first_server: Literal[0, 1] | None = None,
        reward: Literal["match", "rally"] = "match",
        rules: Rules = BWF,
        game: Game | str | None = None,
        outcomes: OutcomesFrom = "tables",
        max_strokes: int | None = None,
        render_mode: RenderMode | None = None,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        options: Any = {"render_mode": render_mode, "record": record, "history": history, "rules": rules}
        super().__init__(game=game, outcomes=outcomes, max_strokes=max_strokes, **options, extra_width=SCORE_WIDTH)
        if isinstance(first_server, float) or first_server not in (None, 0, 1):
            raise OptionError(f"first_server {first_server!r}: expected 0, 1, or None for a random server")
        if reward not in ("match", "rally"):
            raise OptionError(f"reward {reward!r}: expected 'match' or 'rally'")
        self.first_server = first_server
        self.reward = reward
        self.rules = rules
        self._match_winner: int | None = None
        self._set_score(Score(rules=rules))

    def score_of(self, player: int) -> tuple[int, int, int, int]:
        """Own points, the opponent's points, own games and the opponent's games before the current rally."""
        points, games, other = self._score.by_game[-1], self._score.games, 1 - player
        return points[player], points[other], games[player], games[other]

    @property
    def _number(self) -> int:
        return self._rally

    def _begin_episode(self) -> int:
        self._draws = self._draws_of_episode()
        self._rally = 0
        server = self._draws.first_server(0) if self.first_server is None else self.first_server
        self._match_winner = None
        self._set_score(Score(server=server, rules=self.rules))
        return server

    def _draws_of_episode(self) -> RallyDraws:
        assert self.last_seed is not None
        return RallyDraws(self.last_seed, self.episode)

    def _end_rally(self, winner: int) -> None:
        self._set_score(self._score.after(winner))
        if self._score.over:
            self._end_episode(winner)
            return
        if self.reward == "rally":
            self._pay(winner)
        self._rally += 1
        self._begin_rally(winner)

    def _end_episode(self, winner: int) -> None:
        self._match_winner = winner
        super()._end_episode(winner)

    def _set_score(self, score: Score) -> None:
        self._score, server = score, score.server
        first = [*score_fractions(score.by_game[-1], score.games, self.rules), server == 0, server == 1]
        self._scores = np.array(first, np.float32)[[[0, 1, 2, 3, 4, 5], [1, 0, 3, 2, 5, 4]]]

    def _vector(self, row: F32, player: int) -> F32:
        return np.concatenate([row[:RALLY_WIDTH], self._scores[player], row[RALLY_WIDTH:]])

    def _match_info(self) -> dict[str, Any]:
        return {"points": self._score.by_game[-1], "games": self._score.games, "server": AGENTS[self._score.server]}

    def _snapshot_of_match(self) -> dict[str, Any]:
        return {"by_game": self._score.by_game, "match_winner": self._match_winner}


if not TYPE_CHECKING:  # a type checker would take every name for one of this module
    __getattr__ = without_parallel(__name__, __all__)

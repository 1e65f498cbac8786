"""Gymnasium environments for one agent against an opponent: a step is the learner's stroke and the opponent's reply.

``shuttle_marl/Rally-v0`` and ``shuttle_marl/Match-v0`` wrap ``rally_v0`` and ``match_v0``: rules, observations, masks, rendering
and random numbers are those of the wrapped environment. ``RallyRecovery-v0`` and ``MatchRecovery-v0`` are the same with the game
``default:recovery``, in which the learner's steps are its strokes and its positions.
"""

import copy
from pathlib import Path
from typing import Any, Literal, Self, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from shuttle_marl.base.arrays import U8, Bools
from shuttle_marl.base.errors import OptionError, suggesting
from shuttle_marl.env import match_v0, rally_v0
from shuttle_marl.env.aec import AGENTS, RENDER_MODES, Belief, Observation, RenderMode, ShuttleEnv
from shuttle_marl.env.recorded import names_of
from shuttle_marl.env.wrappers import InfoView, MaskView, checked_views
from shuttle_marl.game.pairs import opponent_tables
from shuttle_marl.game.policy import Policy, called, reads_history, reads_score, tabulate
from shuttle_marl.game.rally import choose
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve

Seat = Literal[0, 1]


class Opponent:
    """A policy at the other seat: a table of it, or the policy itself if it reads the score or the rally so far.

    Raises:
        PolicyError: the policy does not exist, or does not return a distribution over the legal strokes.
    """

    def __init__(self, opponent: str | Policy, game: Game) -> None:
        self.policy = resolve(opponent, game) if isinstance(opponent, str) else opponent
        self.reads_score, self.reads_history = reads_score(self.policy), reads_history(self.policy)
        self.given, self.game = opponent, game
        self.chooser = self.policy if self.reads_score or self.reads_history else tabulate(self.policy, game)

    def __reduce__(self) -> tuple[Any, ...]:
        return Opponent, (self.given, self.game)  # by name if possible, because a table has megabytes

    def __deepcopy__(self, memo: dict[int, Any]) -> "Opponent":
        return self  # read-only, and a table takes longer than a rally


class SingleEnv(gymnasium.Env[Observation, np.int64]):
    """Single-agent environment with an opponent at the other seat.

    Episodes that end before the learner's first stroke are skipped and counted in :attr:`unseen`; include them in win rates.

    An illegal stroke loses the episode, as in ``rally_v0.env()``: reward -1, ``terminated``, and ``info["reason"]`` is ``illegal
    stroke``. ``info["illegal"]`` counts the episodes lost so since the last seed.

    Attributes:
        raw: the wrapped PettingZoo environment.
        seat: the learner's seat, 0 or 1.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 2}  # noqa: RUF012  as in gymnasium.Env

    def __init__(
        self, raw: ShuttleEnv, opponent: Opponent, seat: Seat, mask: MaskView, info: InfoView | None, record: Path | str | None
    ) -> None:
        self._mask, self._info_view = mask, checked_views(mask, info)
        if seat not in (0, 1):
            raise OptionError(f"seat {seat!r}: expected 0 or 1")
        self.raw, self.opponent, self.seat = raw, opponent, seat
        if record is not None:
            names = names_of(opponent.given)
            raw.record(record, names if seat == 0 else names[::-1], getattr(raw, "rules", None))
        self.render_mode = raw.render_mode
        self._agent = AGENTS[seat]
        both = raw.observation_space(self._agent)
        self.observation_space = both if mask == "observation" else cast(spaces.Dict, both)["observation"]
        self.action_space = raw.action_space(self._agent)
        self._unseen, self._illegal = np.zeros(2, np.int64), 0
        self._owed = 0.0
        self._over = True

    @property
    def game(self) -> Game:
        """The tables of the game, or the game of a pair."""
        return self.raw.game

    @property
    def state_number(self) -> int:
        """State of the striker, as in :mod:`shuttle_marl.game.tables`."""
        return self.raw.state_number

    @property
    def unseen(self) -> tuple[int, int]:
        """Episodes since the last seed that ended before the learner's first stroke: won and lost by the learner."""
        won, lost = self._unseen.tolist()
        return won, lost

    def action_masks(self) -> Bools:
        """``[n]`` mask of legal actions for sb3-contrib; all False before the first reset."""
        return self.raw.observe(self._agent)["action_mask"].astype(bool)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start the next episode, up to the learner's first stroke; with a seed, the first episode of that seed."""
        super().reset(seed=seed)
        if seed is not None:
            self._unseen[:] = self._illegal = 0
        while True:
            self.raw.reset(seed=seed, options=options)
            seed = None
            self._owed = self._await_turn()
            if not self.raw.terminations[self._agent]:
                self._over = False
                return self._seen(), self._info()
            self._unseen[0 if self.raw.rewards[self._agent] > 0 else 1] += 1

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Play a stroke, its catalogue index, or choose a position, n + position, and let the opponent act.

        Returns:
            Observation, reward since the last step, whether the episode is over, False, and info.

        Raises:
            ActionError: not an integer, or not in the action space.
            ResetNeeded: the episode is over.
            PolicyError: an opponent that has no table raised, or returned no distribution.
        """
        if self._over:
            raise ResetNeeded("the episode is over or has not started; call reset() first")
        try:
            self.raw.step(cast(int, action))
        except IllegalStrokeError as illegal:
            self.raw.forfeit(illegal.stroke)
            self._illegal += 1
        reward = self._owed + self.raw.rewards[self._agent] + self._await_turn()
        self._owed = 0.0
        self._over = self.raw.terminations[self._agent]
        return self._seen(), reward, self._over, False, self._info()

    def fork(self, seed: int | None = None, belief: Belief = None) -> Self:
        """Copy with fresh luck, of the opponent too, for planning; see :meth:`shuttle_marl.env.aec.ShuttleEnv.fork`.

        With Gymnasium's wrappers around this environment, ``env.unwrapped.fork(seed)`` is a copy without them.
        """
        twin = copy.copy(self)
        twin.raw, twin._unseen = self.raw.fork(seed, belief), self._unseen.copy()
        twin.render_mode = twin.raw.render_mode
        return twin

    def render(self) -> U8 | str | None:
        """The rally as text (``ansi``), as a picture from above (``rgb_array``), or in a window (``human``)."""
        return self.raw.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.raw.close()

    def _await_turn(self) -> float:
        """Play the opponent's strokes until the learner's turn or the end of the episode; returns the learner's reward."""
        raw, other, reward = self.raw, self.opponent, 0.0
        self._over = True  # if the opponent fails or is interrupted, the next stroke would be played for it
        while raw.agent_selection != self._agent and not raw.terminations[self._agent]:
            draw, strokes, waits = raw.choice_draw(), raw.strokes if other.reads_history else None, raw.chooses_position
            score = raw.score_of(self.seat if waits else 1 - self.seat)
            raw.step(choose(other.chooser, other.game, raw.state_number, draw, score, strokes, waits=waits))
            reward += raw.rewards[self._agent]
        return reward

    def _seen(self) -> Any:
        seen = self.raw.observe(self._agent)
        return seen if self._mask == "observation" else seen["observation"]

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = {"unseen": self._unseen.copy(), "illegal": np.array(self._illegal)}
        if self._info_view == "full":
            info.update(self.raw.infos[self._agent])
        if self._mask == "info":
            info["action_mask"] = self.raw.observe(self._agent)["action_mask"]
        return info


@suggesting
class SingleRallyEnv(SingleEnv):
    """``shuttle_marl/Rally-v0``: one rally against an opponent, with reward +1 for a win and -1 for a loss.

    Args:
        opponent: name of a policy, or a policy.
        seat: the learner's seat; with a random server it only decides for which draws the learner serves.
        server: seat that serves, 0 or 1; None: random.
        game: the tables, the game of a pair, or a model by name or folder (``default:men``); None: the default game.
        mask, info: as of :func:`shuttle_marl.env.rally_v0.env`.
        render_mode, record, history: as of :class:`shuttle_marl.env.rally_v0.raw_env`.

    Raises:
        OptionError: an invalid option, or an opponent that reads the score, which a rally does not have.
        PolicyError: the opponent does not exist, or does not return a distribution over the legal strokes.
        GameError: the model does not exist.
    """

    def __init__(
        self,
        *,
        opponent: str | Policy = "bc",
        seat: Seat = 0,
        server: Seat | None = None,
        game: Game | str | None = None,
        mask: MaskView = "observation",
        info: InfoView | None = None,
        render_mode: RenderMode | None = None,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        raw = rally_v0.raw_env(server=server, game=game, render_mode=render_mode, history=history)
        other = Opponent(opponent, opponent_tables(raw.game, seat))
        if other.reads_score:
            raise OptionError(f"{called(other.policy)} reads the score, which a rally does not have; use shuttle_marl/Match-v0")
        super().__init__(raw, other, seat, mask, info, record)


@suggesting
class SingleMatchEnv(SingleEnv):
    """``shuttle_marl/Match-v0``: a match against an opponent, who may read the score.

    With ``reward="rally"``, the reward of a step includes all rallies that ended since the last step, also before the learner's
    first stroke, so the return of an episode is the difference of points.

    Args:
        first_server: seat that serves first, 0 or 1; None: random.
        reward: ``match``: +1 and -1 at the end of the match; ``rally``: +1 and -1 at the end of every rally.
        opponent, seat, game, mask, info, render_mode, record, history: as of :class:`SingleRallyEnv`, and likewise the errors.
    """

    def __init__(
        self,
        *,
        opponent: str | Policy = "bc",
        seat: Seat = 0,
        first_server: Seat | None = None,
        reward: Literal["match", "rally"] = "match",
        rules: Rules = BWF,
        game: Game | str | None = None,
        mask: MaskView = "observation",
        info: InfoView | None = None,
        render_mode: RenderMode | None = None,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        options: Any = {"rules": rules, "game": game, "render_mode": render_mode, "history": history}
        raw = match_v0.raw_env(first_server=first_server, reward=reward, **options)
        super().__init__(raw, Opponent(opponent, opponent_tables(raw.game, seat)), seat, mask, info, record)

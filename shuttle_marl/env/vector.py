"""Gymnasium vector environments of rallies and matches against opponents, on the compiled kernel.

In the game with recovery (``default:recovery``) the learner's steps are its strokes and its positions: action n + p is position
p, and the last number of an observation is 1 if the learner is to choose a position.
"""

from pathlib import Path
from typing import Any, Final, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from shuttle_marl.base.arrays import F32, I32, I64, Bools, Intp, Ints
from shuttle_marl.base.errors import ActionError, OptionError, suggesting, whole_number
from shuttle_marl.env.aec import refuse_options
from shuttle_marl.env.history import BatchHistory, features_of
from shuttle_marl.env.recorded import names_of, recorder_of
from shuttle_marl.env.wrappers import InfoView, MaskView, checked_views
from shuttle_marl.game.layout import RALLY_WIDTH, SCORE_WIDTH, STROKE_WIDTH, SWAP_TOKENS, with_efforts
from shuttle_marl.game.pairs import opponent_tables
from shuttle_marl.game.rally import stepper_of
from shuttle_marl.game.rules import ILLEGAL, ILLEGAL_POSITION, REASONS
from shuttle_marl.game.scoring import BWF, Rules, score_fractions
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import MatchBatch, RallyBatch
from shuttle_marl.kernel.rows import Server
from shuttle_marl.kernel.taped import TapeReader
from shuttle_marl.policy.registry import Opponents, tabulated

_REASONS: Final = np.array(REASONS, dtype=object)


class VersusVectorEnv(VectorEnv[Any, Ints, npt.NDArray[Any]]):
    """Base class: row b of B plays the episodes b, b + B, b + 2 B, … of the seed.

    A row is reset in the step in which its episode ends (``AutoresetMode.SAME_STEP``); then ``infos["final_obs"]`` contains its
    last observation and ``infos["final_info"]`` the reason. ``infos["unseen"]``, ``[B, 2]``, counts the skipped episodes that
    each row won and lost before the learner's first stroke, ``infos["illegal"]``, ``[B]``, those lost by an illegal stroke.

    Attributes:
        versus: the batch of the kernel, to assign and replace opponents.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    _features: F32 | None

    def __init__(
        self,
        game: Game,
        batch: RallyBatch,
        highest: npt.NDArray[Any],
        mask: MaskView,
        info: InfoView | None,
        recorder: TapeReader | None,
        history: int,
    ) -> None:
        self._history = BatchHistory(batch, history) if whole_number("history", history, 0) else None
        if history:
            width = 2 * history * (STROKE_WIDTH if self._features is not None else 1)
            highest = np.append(highest, np.full(width, 1 if self._features is not None else game.n_strokes, highest.dtype))
        self._mask, self._info = mask, checked_views(mask, info)
        self.game, self.versus, self.num_envs = game, batch, len(batch)
        n, highest = game.n_actions, np.append(highest, np.ones(int(game.hides), highest.dtype))
        vector = spaces.Box(np.zeros_like(highest), highest, dtype=highest.dtype.type)
        self.single_action_space = spaces.Discrete(n)
        self.single_observation_space = (
            spaces.Dict({"observation": vector, "action_mask": spaces.Box(0, 1, (n,), np.int8)})
            if mask == "observation"
            else vector
        )
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._illegal = np.zeros(self.num_envs, np.int64)
        self._waited = np.zeros(self.num_envs, np.bool_)
        self._begun = False
        self._recorder = recorder

    @property
    def unseen(self) -> tuple[int, int]:
        """Episodes that ended before the learner's first stroke since the last seed: won and lost by the learner."""
        return self.versus.unseen

    def action_masks(self) -> Bools:
        """``[B, n]`` legal strokes of each row; with recovery ``[B, n + 9]`` legal actions."""
        observed = self.versus.new_observations()
        self.versus.observe(observed)
        return observed.mask

    def random_actions(self) -> I64:
        """``[B]`` uniformly sampled legal actions, with the random number of the next stroke of each row."""
        return self.versus.random_actions()[0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start the next episode in every row, up to the learner's first stroke.

        Args:
            seed: start with the first B episodes of this seed; None: continue, or a random seed at the first call.
            options: None or empty.

        Raises:
            OptionError: an option.
        """
        refuse_options(options)
        super().reset(seed=seed)
        if seed is None and not self._begun:
            seed = int(self.np_random.integers(1 << 63))
        self._begun = True
        if seed is not None:
            self._illegal[:] = 0
            if self._recorder is not None:
                self._recorder.reseed(seed)
        self.versus.reset(seed)
        if self._history is not None:
            self._history.begin(np.ones(self.num_envs, np.bool_))
        return self._seen()

    def step(self, actions: Ints) -> tuple[Any, F32, Bools, Bools, dict[str, Any]]:
        """Play a stroke and the opponent's reply in every row; an illegal stroke loses the episode.

        Args:
            actions: ``[B]`` catalogue indices, n + p for position p where the learner is to choose one.

        Returns:
            Observations, ``[B]`` float32 rewards, ``[B]`` whether each episode was over, ``[B]`` False, and infos.

        Raises:
            ActionError: an action is not in the catalogue.
            ResetNeeded: no episode has started.
        """
        self._require_begun()
        actions = np.asarray(actions)
        whole = actions.dtype.kind in "iu" and actions.shape == (self.num_envs,)
        if not whole or not ((actions >= 0) & (actions < self.game.n_actions)).all():
            raise ActionError(f"actions {actions!r}: expected {self.num_envs} integers from 0 to {self.game.n_actions - 1}")
        tape = self.versus.tape
        before, self._waited = self.versus.rows.state.copy(), self.versus.waits
        noted = None if tape is None else tape.used.copy()
        rewards, terminated, illegal = self._play(before, actions)
        if illegal.any():
            self._lose(illegal, noted)
        if self._history is not None:
            self._history.step(~illegal)
        final: dict[str, Any] = {}
        if terminated.any():
            if self._info == "full":
                final = self._final(np.flatnonzero(terminated), terminated, before, illegal, rewards)
            self.versus.reset(rows=terminated)
            if self._history is not None:
                self._history.begin(terminated)
        if self._recorder is not None:
            self._recorder.step()
        seen, infos = self._seen()
        return seen, rewards, terminated, np.zeros_like(terminated), {**infos, **final}

    def _lose(self, illegal: Bools, noted: I32 | None) -> None:
        if not self._illegal.any():
            gymnasium.logger.warn(
                "an action was illegal, which loses the episode: choose by the action_mask; infos['illegal'] counts them"
            )
        self._illegal += illegal
        if (tape := self.versus.tape) is not None and noted is not None:
            # What the kernel has played instead is not part of the rally.
            tape.used[illegal] = noted[illegal]
            for waited, reason in ((False, ILLEGAL), (True, ILLEGAL_POSITION)):
                self.versus.cut(np.flatnonzero(illegal & (self._waited == waited)), reason)

    def close_extras(self, **_: Any) -> None:
        """Finish the log of rallies, if there is one."""
        if self._recorder is not None:
            self._recorder.close()

    def _require_begun(self) -> None:
        if not self._begun:
            raise ResetNeeded("no episode has started; call reset() first")

    def _play(self, before: I32, actions: Ints) -> tuple[F32, Bools, Bools]:
        """``[B]`` each: rewards, whether the episode is over, and whether the stroke was illegal."""
        raise NotImplementedError

    def _vectors(self, rows: Intp, state: I32, own: Bools, waits: Bools) -> npt.NDArray[Any]:  # noqa: ARG002
        """``[D, w]`` what the learners of some rows see in states, as strikers (``own``) or to choose a position (``waits``)."""
        if self._features is None:
            found = self.game.observation(state)
            found = np.where(own[:, None], found, found[:, SWAP_TOKENS])
            return np.column_stack([found, waits.astype(np.int32)]) if self.game.hides else found
        seen = with_efforts(self.game, self._features, state, ~own)
        seen[:, RALLY_WIDTH:] = waits[:, None]
        return seen

    def _with_history(self, vectors: npt.NDArray[Any], rows: Intp) -> npt.NDArray[Any]:
        if self._history is None:
            return vectors
        strokes, end = self._history.strokes[rows], vectors.shape[1] - self.game.hides
        more = strokes.reshape(len(rows), -1) if self._features is None else features_of(self.game, strokes)
        return np.concatenate([vectors[:, :end], more, vectors[:, end:]], axis=1)

    def _won_by_stroke(self, rows: Intp, own: Bools, rewards: F32) -> Bools:
        """``[D]`` whether the last stroke was a winner rather than a fault."""
        raise NotImplementedError

    def _seen(self) -> tuple[Any, dict[str, Any]]:
        observed = self.versus.new_observations()
        self.versus.observe(observed)
        mask, vectors = observed.mask.view(np.int8), observed.tokens
        if self._features is not None:
            waits = self.versus.waits
            vectors = self._vectors(np.arange(self.num_envs), self.versus.rows.state, ~waits, waits)
        every = np.ones(self.num_envs, np.bool_)
        vectors = self._with_history(vectors, np.arange(self.num_envs))
        infos: dict[str, Any] = {"unseen": self.versus.opponents.unseen.copy(), "_unseen": every}
        infos |= {"illegal": self._illegal.copy(), "_illegal": every.copy()}
        if self._mask == "info":
            infos |= {"action_mask": mask, "_action_mask": every.copy()}
        return ({"observation": vectors, "action_mask": mask} if self._mask == "observation" else vectors), infos

    def _final(self, rows: Intp, over: Bools, before: I32, illegal: Bools, rewards: F32) -> dict[str, Any]:
        kernel, lost = self.versus, illegal[rows]
        # The learner is the receiver of the final state if the last stroke was theirs.
        own = np.where(lost, ~self._waited[rows], kernel.rows.striker[rows] == kernel.opponents.seat[rows])
        state = np.where(illegal, before, kernel.rows.state)[rows]
        vectors = self._with_history(self._vectors(rows, state, own, np.zeros(len(rows), np.bool_)), rows)
        nothing = np.zeros(self.game.n_actions, np.int8)
        seen = np.full(self.num_envs, None, dtype=object)
        reason = np.full(self.num_envs, None, dtype=object)
        for row, vector in zip(rows, vectors, strict=True):
            seen[row] = {"observation": vector, "action_mask": nothing} if self._mask == "observation" else vector
        reason[rows] = _REASONS[np.where(lost, ILLEGAL + self._waited[rows], self._won_by_stroke(rows, own, rewards))]
        return {
            "final_obs": seen,
            "_final_obs": over.copy(),
            "final_info": {"reason": reason, "_reason": over.copy()},
            "_final_info": over.copy(),
        }


@suggesting
class RallyVectorEnv(VersusVectorEnv):
    """B copies of ``shuttle_marl/Rally-v0``.

    Args:
        num_envs: number of rallies B.
        opponent: name of a policy, a policy, or a sequence of K; row b plays number b modulo K.
        seat: the learner's seat, 0 or 1, in all rows or ``[B]`` in each.
        server: seat that serves, 0 or 1; None: random.
        game: the tables, the game of a pair, or a model by name or folder (``default:men``); None: the default game.
        observation: ``features``: the 60 numbers of ``rally_v0``; ``tokens``: own last stroke, incoming stroke (n: none yet),
            contact height, consecutive net shots, own effort, the opponent's, and hurried as seven integers, for embeddings.
        mask: as of :func:`shuttle_marl.env.rally_v0.env`.
        info: ``full``; ``none``: no ``final_obs`` and ``final_info``. Default: full with ``mask="observation"``, else none.
        threads: number of threads; does not change results.
        record: file for a log of every rally, see :class:`shuttle_marl.env.recorded.Recording`; None: no log.
        history: number K of the last strokes of each player that observations have too, as of
            :class:`shuttle_marl.env.rally_v0.raw_env`; of ``tokens`` 2 K catalogue indices.

    Raises:
        OptionError: an invalid option.
        KernelError: likewise.
        PolicyError: an opponent does not exist, reads the score, or does not return a distribution over the legal strokes.
        GameError: the model does not exist.
        RecordingError: the log exists or cannot be created.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        opponent: Opponents = "bc",
        seat: int | Ints = 0,
        server: Server = None,
        game: Game | str | None = None,
        observation: Literal["features", "tokens"] = "features",
        mask: MaskView = "observation",
        info: InfoView | None = None,
        threads: int = 1,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        if observation not in ("features", "tokens"):
            raise OptionError(f"observation {observation!r}: expected 'features' or 'tokens'")
        tables = resolve_game(game)
        opponents = tabulated(opponent, opponent_tables(tables, seat))
        options: Any = {"seat": seat, "server": server, "threads": threads, "record": record is not None}
        batch = RallyBatch(tables, num_envs, opponents=opponents, **options)
        features = observation == "features"
        self._features = stepper_of(tables).observations if features else None
        highest = np.ones(RALLY_WIDTH, np.float32) if features else tables.highest_observation
        recorder = recorder_of(batch, record, names_of(opponent))
        super().__init__(tables, batch, highest, mask, info, recorder, history)

    def _play(self, before: I32, actions: Ints) -> tuple[F32, Bools, Bools]:  # noqa: ARG002
        illegal = self.versus.ranks(actions) < 0
        if illegal.any():
            # The rally is lost anyway, so it continues with any legal action.
            actions = np.where(illegal, self.action_masks().argmax(axis=1), actions)
        rewards, terminated = self.versus.step(actions, reset=False)
        rewards[illegal], terminated[illegal] = -1, True
        return rewards, terminated, illegal

    def _won_by_stroke(self, rows: Intp, own: Bools, rewards: F32) -> Bools:
        return (rewards[rows] > 0) != own


@suggesting
class MatchVectorEnv(VersusVectorEnv):
    """B copies of ``shuttle_marl/Match-v0``, with the same episodes, for opponents that do not read the score.

    ``infos["points"]`` and ``infos["games"]`` are ``[B, 2]``, the learner's first.

    Args:
        first_server: seat that serves first, 0 or 1; None: random.
        reward: ``match``: +1 and -1 at the end of the match; ``rally``: +1 and -1 at the end of every rally.
        num_envs, opponent, seat, game, mask, info, threads, record, history: as of :class:`RallyVectorEnv`, and the errors.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        opponent: Opponents = "bc",
        seat: int | Ints = 0,
        first_server: Server = None,
        reward: Literal["match", "rally"] = "match",
        rules: Rules = BWF,
        game: Game | str | None = None,
        mask: MaskView = "observation",
        info: InfoView | None = None,
        threads: int = 1,
        record: Path | str | None = None,
        history: int = 0,
    ) -> None:
        if reward not in ("match", "rally"):
            raise OptionError(f"reward {reward!r}: expected 'match' or 'rally'")
        tables = resolve_game(game)
        self.rules = rules
        self._features = stepper_of(tables).observations
        batch = MatchBatch(
            tables,
            num_envs,
            opponents=tabulated(opponent, opponent_tables(tables, seat)),
            seat=seat,
            server=first_server,
            rules=rules,
            each_rally=reward == "rally",
            threads=threads,
            record=record is not None,
        )
        self._matches = batch.matches
        recorder = recorder_of(batch, record, names_of(opponent), rules)
        super().__init__(tables, batch, np.ones(RALLY_WIDTH + SCORE_WIDTH, np.float32), mask, info, recorder, history)

    def _play(self, before: I32, actions: Ints) -> tuple[F32, Bools, Bools]:  # noqa: ARG002
        rewards, terminated = self.versus.step(actions, reset=False)
        return rewards, terminated, self._matches.reason == ILLEGAL

    def _vectors(self, rows: Intp, state: I32, own: Bools, waits: Bools) -> npt.NDArray[Any]:
        seen = super()._vectors(rows, state, own, waits)
        return np.concatenate([seen[:, :RALLY_WIDTH], self._scores(rows), seen[:, RALLY_WIDTH:]], axis=1)

    def _won_by_stroke(self, rows: Intp, own: Bools, rewards: F32) -> Bools:  # noqa: ARG002
        return self._matches.reason[rows] == 1

    def _seen(self) -> tuple[Any, dict[str, Any]]:
        seen, infos = super()._seen()
        every, matches = np.arange(self.num_envs), self._matches
        for name, values in (("points", matches.points), ("games", matches.games)):
            infos[name], infos[f"_{name}"] = np.stack(self._of_seats(values, every), axis=1), infos["_unseen"].copy()
        return seen, infos

    def _of_seats(self, values: I32, rows: Intp) -> tuple[I32, I32]:
        """``[D]`` each: values of the learner's seat and of the opponent's."""
        seat = self.versus.opponents.seat[rows].astype(np.intp)
        return values[rows, seat], values[rows, 1 - seat]

    def _scores(self, rows: Intp) -> F32:
        """``[D, 6]`` score observed by each learner; see ``match_v0``."""
        matches = self._matches
        shares = score_fractions(self._of_seats(matches.points, rows), self._of_seats(matches.games, rows), self.rules)
        serves = matches.server[rows] == self.versus.opponents.seat[rows]
        return np.stack([*shares, serves, ~serves], axis=1).astype(np.float32)

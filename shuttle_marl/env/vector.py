"""Thousands of rallies against opponents as one Gymnasium vector environment, on the compiled kernel."""

from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from shuttle_marl.env.rally_v0 import ILLEGAL
from shuttle_marl.env.strokes import tables_of
from shuttle_marl.errors import ActionError, OptionError
from shuttle_marl.game.observation import RALLY_WIDTH, SWAP, with_efforts
from shuttle_marl.game.rally import FAULT, OUTCOMES, WINNER, Game
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.kernel import VersusBatch
from shuttle_marl.kernel.rows import Server
from shuttle_marl.policy.registry import Opponents, tabulated

Arrays = dict[str, npt.NDArray[Any]]

_REASONS: Final = np.array([OUTCOMES[FAULT], OUTCOMES[WINNER], ILLEGAL], dtype=object)


class RallyVectorEnv(VectorEnv[Arrays, npt.NDArray[np.integer], npt.NDArray[Any]]):
    """``shuttle_marl/Rally-v0`` B times: row b plays the episodes b, b + B, b + 2 B, … of the seed.

    Rallies begin again in the step in which they end (``AutoresetMode.SAME_STEP``). Where they end, ``infos["final_obs"]``
    holds the last observation of a row and ``infos["final_info"]`` the reason; ``infos["unseen"]`` is ``[B, 2]``: rallies that
    each row won and lost on the opponent's serve, so that they never came to the learner.

    Args:
        num_envs: number of rallies B.
        opponent: name of a policy, a policy, or K of them; row b meets number b modulo K.
        seat: the learner's seat, 0 or 1, in all rows or ``[B]`` in each.
        server: seat that serves, 0 or 1; None: at random, seeded.
        game: the tables, or a model by name or folder; None: the benchmark's.
        profile: variant of that model, such as ``men`` or ``women``; None: its game itself, the average of the two.
        observation: ``features``: the 59 numbers of ``rally_v0``; ``tokens``: own last stroke, incoming stroke (n: none yet),
            contact, net shots in a row, own effort and the opponent's as six integers, which cost less and suit embeddings.
        threads: threads that share the rows; never changes a result.

    Raises:
        OptionError: an option that is not among those.
        KernelError: likewise.
        PolicyError: there is no such opponent, it is no distribution over the legal strokes, or it reads the score.
        GameError: there is no such model.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        *,
        opponent: Opponents = "bc",
        seat: int | npt.NDArray[np.integer] = 0,
        server: Server = None,
        game: Game | str | None = None,
        profile: str | None = None,
        observation: Literal["features", "tokens"] = "features",
        threads: int = 1,
    ) -> None:
        if observation not in ("features", "tokens"):
            raise OptionError(f"observation {observation!r}: expected 'features' or 'tokens'")
        self.num_envs = num_envs
        self.game = resolve_game(game, profile)
        self._batch = VersusBatch(
            self.game, num_envs, opponents=tabulated(opponent, self.game), seat=seat, server=server, threads=threads
        )
        self._features = tables_of(self.game).rows if observation == "features" else None
        n, highest = self.game.n_strokes, self.game.highest_observation
        self.single_action_space = spaces.Discrete(n)
        self.single_observation_space = spaces.Dict(
            {
                "observation": spaces.Box(0.0, 1.0, (RALLY_WIDTH,), np.float32)
                if observation == "features"
                else spaces.Box(np.zeros_like(highest), highest, dtype=np.int32),
                "action_mask": spaces.Box(0, 1, (n,), np.int8),
            }
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._begun = False

    @property
    def versus(self) -> VersusBatch:
        """The batch of the kernel, to assign and replace opponents."""
        return self._batch

    @property
    def unseen(self) -> tuple[int, int]:
        """Rallies that ended on the opponent's serve since the last seed: won and lost by the learner."""
        return self._batch.unseen

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """``[B, n]`` legal strokes of each row."""
        return self.game.mask(self._batch.rows.state)

    def random_actions(self) -> npt.NDArray[np.int64]:
        """``[B]`` a legal stroke for each row, equally likely, by the draw of the stroke that is due."""
        return self._batch.random_strokes()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
        """Start the next episode in every row, up to the learner's first stroke.

        Args:
            seed: begin again, with the first B episodes of this seed; without one at the first call, one is drawn.
            options: ``reset_mask``: ``[B]`` bool, which rows; not together with a seed.

        Raises:
            OptionError: a mask of another shape or type, or one together with a seed.
            ResetNeeded: a mask before all rows were reset.
        """
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            if seed is not None:
                raise OptionError("a seed begins all rows again; give either seed or options['reset_mask']")
            if not isinstance(mask, np.ndarray) or mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
                raise OptionError(f"options['reset_mask']: expected a bool array of shape ({self.num_envs},)")
            self._require_begun()
        super().reset(seed=seed)
        if seed is None and not self._begun:
            seed = int(self.np_random.integers(1 << 63))
        self._begun = True
        self._batch.reset(seed, mask)
        return self._seen(), self._infos()

    def step(
        self, actions: npt.NDArray[np.integer]
    ) -> tuple[Arrays, npt.NDArray[np.float32], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Play a stroke and the opponent's reply in every row; an illegal stroke loses the rally.

        Args:
            actions: ``[B]`` catalogue indices.

        Returns:
            Observations, ``[B]`` float32 rewards, ``[B]`` whether each rally was over, ``[B]`` False, and infos.

        Raises:
            ActionError: an action that is no stroke of the catalogue.
            ResetNeeded: no rally has begun.
        """
        self._require_begun()
        batch, rows = self._batch, self._batch.rows
        actions = np.asarray(actions)
        whole = actions.dtype.kind in "iu" and actions.shape == (self.num_envs,)
        if not whole or not ((actions >= 0) & (actions < self.game.n_strokes)).all():
            raise ActionError(
                f"actions {actions!r}: expected {self.num_envs} numbers from 0 to {self.game.n_strokes - 1}, all of them whole"
            )
        before = rows.state.copy()
        illegal = self.game.rank(before, actions) < 0
        if illegal.any():
            # The rally is lost whatever else is played in it, so let it continue with any legal stroke.
            actions = np.where(illegal, self.game.stroke_at(before, 0), actions)
        rewards, terminated = batch.step(actions, reset=False)
        rewards[illegal], terminated[illegal] = -1, True
        if not terminated.any():
            return self._seen(), rewards, terminated, np.zeros_like(terminated), self._infos()
        ended = np.flatnonzero(terminated)
        state = np.where(illegal, before, rows.state)[ended]
        # The learner looks from the other side where the last stroke was theirs.
        own = illegal[ended] | (rows.striker[ended] == batch.opponents.seat[ended])
        won_by_stroke = (rewards[ended] > 0) != own
        reasons = _REASONS[np.where(illegal[ended], 2, won_by_stroke.astype(np.intp))]
        final = self._final(state, own)
        batch.reset(rows=terminated)
        infos = self._infos()
        infos["final_obs"], infos["_final_obs"] = np.full(self.num_envs, None, dtype=object), terminated.copy()
        infos["final_obs"][ended] = final
        reason = np.full(self.num_envs, None, dtype=object)
        reason[ended] = reasons
        infos["final_info"] = {"reason": reason, "_reason": terminated.copy()}
        infos["_final_info"] = terminated.copy()
        return self._seen(), rewards, terminated, np.zeros_like(terminated), infos

    def _require_begun(self) -> None:
        if not self._begun:
            raise ResetNeeded("no rally has begun; call reset() first")

    def _seen(self) -> Arrays:
        seen = self._batch.new_observations()
        self._batch.observe(seen)
        observation = seen.tokens if self._features is None else with_efforts(self.game, self._features, self._batch.rows.state)
        return {"observation": observation, "action_mask": seen.mask.view(np.int8)}

    def _final(self, state: npt.NDArray[np.int32], own: npt.NDArray[np.bool_]) -> list[Arrays]:
        """Observation of each of D rallies that are over, from the learner's side."""
        if self._features is None:
            striker = self.game.observation(state)
            observation: npt.NDArray[Any] = np.where(own[:, None], striker, striker[:, [1, 0, 2, 3, 5, 4]])
        else:
            rows = with_efforts(self.game, self._features, state)
            observation = np.where(own[:, None], rows, rows[:, SWAP])
        nothing = np.zeros((len(state), self.game.n_strokes), np.int8)
        return [{"observation": o, "action_mask": m} for o, m in zip(observation, nothing, strict=True)]

    def _infos(self) -> dict[str, Any]:
        return {"unseen": self._batch.opponents.unseen.copy(), "_unseen": np.ones(self.num_envs, np.bool_)}

"""Batched TorchRL environments: ``RallyEnv`` for self-play, ``VersusEnv`` against opponents.

Both use the compiled kernel and store their rallies in numpy arrays, so they are stateful and locked to their batch size.
The same seed and strokes give the rallies of ``rally_v0``: row b of B plays the episodes b, b + B, …
"""

from typing import Any, cast

import numpy as np

from shuttle_marl.base.arrays import I32
from shuttle_marl.base.errors import seed_number, suggesting, whole_number
from shuttle_marl.base.extras import hinted
from shuttle_marl.env.aec import AGENTS
from shuttle_marl.env.history import BatchHistory
from shuttle_marl.env.recorded import Record, names_of, recorder_of
from shuttle_marl.game.pairs import opponent_tables
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.kernel.rows import Observations, Server
from shuttle_marl.kernel.taped import TapeReader
from shuttle_marl.policy.registry import Opponents, tabulated

with hinted():
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
    from torchrl.envs import EnvBase


class _Choices(Categorical):
    """Choices with a mask of the present state, which copies share: collectors without a policy sample from a copy."""

    _shared: list[torch.Tensor | None]

    @property
    def mask(self) -> torch.Tensor | None:
        """``[B, n]`` the choices of the present state, in all copies; None: all of them."""
        return self._shared[0]

    @mask.setter
    def mask(self, mask: torch.Tensor | None) -> None:
        self.__dict__.setdefault("_shared", [None])[0] = mask

    def clone(self) -> "_Choices":
        copied = super().clone()
        copied._shared = self._shared
        return cast(_Choices, copied)

    def is_in(self, val: torch.Tensor) -> bool:
        """Whether these are choices of any state, as those of a rollout."""
        return bool(((val >= 0) & (val < self.n)).all())


class _BatchedEnv(EnvBase):
    """TorchRL environment of a batch of the kernel.

    Entries of its tensordicts, batch size ``[B]``:

    - ``observation``: ``[B, 7]`` int32: own last stroke and incoming stroke as catalogue indices (n: none yet), contact
      height (1: above the net), consecutive net shots (3: three or more), own effort, the opponent's, and hurried (1: yes).
    - ``action_mask``: ``[B, n]`` bool legal strokes.
    - ``action``: ``[B]`` int64 catalogue index.
    - ``history``, with that option: ``[B, 2, K]`` int32 last strokes, own ones, then the opponent's, latest first, n: none.
    - ``reward``: ``[B, 1]`` float32; ``done``, ``terminated``: ``[B, 1]`` bool.

    In the game with recovery observations have an eighth number, 1 if the learner is to choose a position, and position p is
    action n + p. In self-play (:class:`RallyEnv`) a step stays one stroke: ``position``, ``[B]`` int64, is chosen beside
    ``action``, under ``position_mask``, ``[B, 9]``.

    ``rollout`` and the collectors reset rows in the same call as the step. So where ``("next", "terminated")`` is True, the
    other entries of ``"next"`` belong to the next rally; estimators ignore them there.
    """

    batch_locked = True

    def __init__(self, game: Game, batch: RallyBatch, seed: int, recorder: TapeReader | None, history: int) -> None:
        size = len(batch)
        super().__init__(batch_size=torch.Size([size]))
        # EnvBase is an nn.Module, so attributes can only be set after the call above.
        self.game = game
        self._batch = batch
        self._next_seed: int | None = seed
        self.recorder = recorder
        self._parts = {"action": game.n_strokes, "position": N_POSITIONS} if batch.joint else {"action": game.n_actions}
        highest = torch.from_numpy(np.append(game.highest_observation, np.int32(1))[: 7 + game.hides])
        self.observation_spec = Composite(
            observation=Bounded(0, highest.expand(size, -1), dtype=torch.int32),
            **{f"{part}_mask": Binary(shape=(size, n), dtype=torch.bool) for part, n in self._parts.items()},
            shape=(size,),
        )
        choices = {part: _Choices(n, shape=(size,), dtype=torch.int64) for part, n in self._parts.items()}
        self.full_action_spec = Composite(**choices, shape=(size,))
        self._history = BatchHistory(batch, history) if whole_number("history", history, 0) else None
        if self._history is not None:
            self.observation_spec["history"] = Bounded(0, game.n_strokes, (size, 2, history), dtype=torch.int32)
        self._choices: list[_Choices] = list(self.full_action_spec.values())
        self.reward_spec = Unbounded((size, 1))
        over = Categorical(2, shape=(size, 1), dtype=torch.bool)
        self.full_done_spec = Composite(done=over, terminated=over.clone(), shape=(size,))

    @property
    def states(self) -> I32:
        """``[B]`` state index of each striker in :mod:`shuttle_marl.game.tables`; a copy."""
        return self._batch.rows.state.copy()

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Sample a legal stroke uniformly for each row, with the random number of the next stroke."""
        if tensordict is None:
            tensordict = TensorDict(batch_size=self.batch_size)
        for part, chosen in zip(self._parts, self._batch.random_actions(), strict=False):
            tensordict.set(part, torch.from_numpy(chosen))
        return tensordict

    def _set_seed(self, seed: int | None) -> None:
        """The next reset starts with rally 0 of this seed."""
        self._next_seed = None if seed is None else seed_number(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        which = None if tensordict is None else tensordict.get("_reset", None)
        if self._next_seed is not None:
            if self.recorder is not None:
                self.recorder.reseed(self._next_seed)
            self._batch.reset(self._next_seed)
            self._next_seed = None
        elif which is None:
            self._batch.reset()
        else:
            self._batch.reset(rows=which.view(-1).numpy())
        if self._history is not None:
            self._history.begin(np.ones(len(self._batch), np.bool_) if which is None else which.view(-1).numpy())
        none = torch.zeros(len(self._batch), 1, dtype=torch.bool)
        seen = self._batch.new_observations()
        self._batch.observe(seen)
        return TensorDict({**self._tensors(seen), "done": none, "terminated": none.clone()}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        entries, done = self._play(tensordict, reset=False)
        return TensorDict({**entries, "terminated": done.clone()}, self.batch_size)

    def step_and_maybe_reset(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        """Step and reset in one call of the kernel; TorchRL's own implementation takes three to five times as long."""
        entries, done = self._play(tensordict, reset=True)
        tensordict.set("next", _unchecked({**entries, "terminated": done.clone()}, self.batch_size))
        none = torch.zeros_like(done)
        begun = {name: entry for name, entry in entries.items() if name not in ("reward", "done")}
        return tensordict, _unchecked({**begun, "done": none, "terminated": none.clone()}, self.batch_size)

    def _play(self, tensordict: TensorDictBase, *, reset: bool) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Entries with observation, reward and done after a stroke in every row; and done."""
        seen = self._batch.new_observations()
        chosen = (tensordict.get(part).numpy() for part in self._parts)
        reward, over = self._batch.step(*chosen, reset=reset, observed=seen)
        if self.recorder is not None:
            self.recorder.step()
        if self._history is not None:
            self._history.step()
        done = torch.from_numpy(over).unsqueeze(-1)
        return {**self._tensors(seen), "reward": torch.from_numpy(reward).unsqueeze(-1), "done": done}, done

    def read_rallies(self) -> None:
        """Record all rallies that have ended, which otherwise happens every few steps."""
        if self.recorder is not None:
            self.recorder.read()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Finish the log of rallies, if there is one."""
        if self.recorder is not None:
            self.recorder.close()
        super().close(raise_if_closed=raise_if_closed)

    def _tensors(self, seen: Observations) -> dict[str, torch.Tensor]:
        split = np.split(seen.mask, np.cumsum([*self._parts.values()])[:-1], axis=1)
        masks = {f"{part}_mask": torch.from_numpy(mask) for part, mask in zip(self._parts, split, strict=True)}
        for choices, legal in zip(self._choices, masks.values(), strict=True):
            choices.mask = legal
        strokes = {} if self._history is None else {"history": torch.from_numpy(self._history.strokes.copy())}
        return {"observation": torch.from_numpy(seen.tokens), **masks, **strokes}


def _unchecked(entries: dict[str, torch.Tensor], batch_size: torch.Size) -> TensorDict:
    """A tensordict without shape checks, which take longer than a step."""
    return TensorDict._new_unsafe(source=entries, batch_size=batch_size)


@suggesting
class RallyEnv(_BatchedEnv):
    """B rallies for self-play: each step of a rollout is one stroke, of the two players in turn, observed by the striker.

    Rewards and values are those of the striker, so the value of the next state belongs to the opponent: estimators of returns and
    advantages with ``gamma=-1`` are exact in this zero-sum game.

    Args:
        batch: number of rallies B.
        game: the tables, the game of a pair, or a model by name or folder (``default:men``); None: the default game.
        server: seat that serves, 0 or 1; None: random.
        threads: number of threads; does not change results.
        record: file for a log of every rally, see :class:`shuttle_marl.env.recorded.Recording`, or a function that is given
            the rallies as they end; None: no log.
        history: number K of the last strokes of each player in the entry ``history``; 0: there is none.

    Raises:
        KernelError: an invalid option.
        GameError: the model does not exist.
    """

    def __init__(
        self,
        batch: int = 1024,
        *,
        game: Game | str | None = None,
        seed: int = 0,
        server: Server = None,
        threads: int = 1,
        record: Record = None,
        history: int = 0,
    ) -> None:
        resolved = resolve_game(game)
        rallies = RallyBatch(resolved, batch, seed=seed, server=server, threads=threads, record=record is not None)
        super().__init__(resolved, rallies, seed, recorder_of(rallies, record, AGENTS), history)


@suggesting
class VersusEnv(_BatchedEnv):
    """B rallies of a learner against opponents: each step of a rollout is the learner's stroke and the reply.

    A single-agent environment (``gamma=1``). Rallies that end on the opponent's serve are skipped and counted in :attr:`unseen`;
    include them in win rates.

    Args:
        batch: number of rallies B.
        opponents: name of a policy, a policy, or a sequence of K; row b plays number b modulo K.
        seed: random seed of rallies and opponents.
        seat: seat of the learner, 0 or 1.
        game, server, threads, record, history: as of :class:`RallyEnv`.

    Raises:
        KernelError: an invalid option.
        PolicyError: an opponent does not exist, reads the score, or does not return a distribution over the legal strokes.
        GameError: the model does not exist.
    """

    def __init__(
        self,
        batch: int = 1024,
        *,
        opponents: Opponents = "bc",
        game: Game | str | None = None,
        seed: int = 0,
        seat: int = 0,
        server: Server = None,
        threads: int = 1,
        record: Record = None,
        history: int = 0,
    ) -> None:
        resolved = resolve_game(game)
        others = tabulated(opponents, opponent_tables(resolved, seat))
        options: Any = {"seed": seed, "seat": seat, "server": server, "threads": threads, "record": record is not None}
        rallies = RallyBatch(resolved, batch, opponents=others, **options)
        super().__init__(resolved, rallies, seed, recorder_of(rallies, record, names_of(opponents)), history)

    @property
    def versus(self) -> RallyBatch:
        """The batch of the kernel, to assign and replace opponents."""
        return self._batch

    @property
    def unseen(self) -> tuple[int, int]:
        """Rallies that ended on the opponent's serve since the last seed: won and lost by the learner."""
        return self._batch.unseen

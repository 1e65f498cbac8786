"""Base class of ``rally_v0`` and ``match_v0``: a PettingZoo AEC environment of two players."""

import copy
import operator
import secrets
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Self, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from pettingzoo import AECEnv

from shuttle_marl.base.arrays import F32, I8, U8
from shuttle_marl.base.errors import ActionError, OptionError, seed_number, whole_number
from shuttle_marl.base.extras import hinted
from shuttle_marl.env.render import CourtRenderer, Snapshot, as_text
from shuttle_marl.game.draws import stream
from shuttle_marl.game.layout import RALLY_WIDTH, STROKE_WIDTH, stroke_features
from shuttle_marl.game.policy import Policy, States, UniformPolicy
from shuttle_marl.game.rally import RallyDraws, Stepper, Stroke, choose, stepper_of
from shuttle_marl.game.rules import (
    ABANDONED,
    FAULT,
    ILLEGAL,
    ILLEGAL_POSITION,
    NOBODY,
    OUTCOMES,
    REASONS,
    RETURNED_BELOW,
    TOO_LONG,
    IllegalStrokeError,
)
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import ROOT, Game

if TYPE_CHECKING:
    from shuttle_marl.env.recorded import Recording

AGENTS: Final = ("player_0", "player_1")
RENDER_MODES: Final = ("human", "rgb_array", "ansi")
RenderMode = Literal["human", "rgb_array", "ansi"]
OutcomesFrom = Literal["tables", "models"]  # the tables, or the PyTorch modules behind them
METADATA: Final = {"render_modes": list(RENDER_MODES), "is_parallelizable": False, "render_fps": 2}
Observation = dict[str, npt.NDArray[Any]]  # observation of an agent: ``observation`` and ``action_mask``

_INDEX: Final = {agent: i for i, agent in enumerate(AGENTS)}
_LISTED: Final = 20


class ShuttleEnv(AECEnv[str, Observation, int]):
    """Turn-based environment of two players; subclasses define what happens at the end of a rally.

    In the game with recovery an agent whose stroke is returned acts again: it chooses where it waits, action n + position, unless
    only one position is feasible. Then the opponent strikes without knowing it. No observation, info, state or text of a running
    rally depends on a position that was chosen.

    ``copy`` and ``pickle`` make exact copies, for checkpoints: the same strokes have the same outcomes as in the original, and a
    hidden position is in them. A planner that tries strokes on such copies sees the future, so copies of a running episode warn;
    :meth:`fork` copies with fresh luck.

    Attributes:
        game: the tables of the game, or the game of a pair.
        state_space: space of :meth:`state`.
        recorder: the log of its rallies, of which copies and forks have none; None: rallies are not recorded.
        last_seed: the last seed; an episode depends only on it and on its number.
        episode: number of the episode since the last seed, from 0.
    """

    rewards: dict[str, float]
    _cumulative_rewards: dict[str, float]
    terminations: dict[str, bool]
    truncations: dict[str, bool]
    infos: dict[str, dict[str, Any]]

    def __init__(
        self,
        *,
        game: Game | str | None,
        outcomes: OutcomesFrom,
        max_strokes: int | None,
        render_mode: RenderMode | None,
        extra_width: int,
        record: Path | str | None = None,
        rules: Rules | None = None,
        history: int = 0,
    ) -> None:
        super().__init__()
        if render_mode not in (None, *RENDER_MODES):
            raise OptionError(f"render_mode {render_mode!r}: expected one of {', '.join(RENDER_MODES)}, or None")
        self.game = resolve_game(game)
        self.render_mode = render_mode
        self.max_strokes = None if max_strokes is None else whole_number("max_strokes", max_strokes, 1)
        self.last_seed: int | None = None
        self.episode = -1
        self.possible_agents = list(AGENTS)
        self.agents: list[str] = []
        self._stepper = _stepper(self.game, outcomes)
        self._history = whole_number("history", history, 0)
        n, width = self._stepper.n_actions, RALLY_WIDTH + extra_width + 2 * STROKE_WIDTH * history + self.game.hides
        self.action_spaces = {agent: spaces.Discrete(n) for agent in AGENTS}
        self.observation_spaces = {
            agent: spaces.Dict(
                {"observation": spaces.Box(0.0, 1.0, (width,), np.float32), "action_mask": spaces.Box(0, 1, (n,), np.int8)}
            )
            for agent in AGENTS
        }
        self.state_space = spaces.Box(0.0, 1.0, (width + 1,), np.float32)
        self.agent_selection = AGENTS[0]
        self._clear_episode()
        self._state = ROOT
        self._live = False
        self._striker = 0
        self._choosing = False
        self._position: int | None = None
        self._draws = RallyDraws(0)
        self._rally = 0
        self._strokes: list[Stroke] = []
        self._positions: list[int | None] = []
        self._reason: str | None = None
        self._winner: int | None = None
        self._renderer: CourtRenderer | None = None
        self.recorder: Recording | None = None
        if record is not None:
            self.record(record, AGENTS, rules)

    def record(self, path: Path | str, names: Sequence[str], rules: Rules | None) -> None:
        """Record every rally from here on, see :class:`shuttle_marl.env.recorded.Recording`."""
        from shuttle_marl.env.recorded import Recording  # noqa: PLC0415  pyarrow and numba, which play does not need

        self.recorder = Recording(path, self.game, names, rules)
        self.recorder.finish_with(self)

    def __getstate__(self) -> dict[str, Any]:
        if self._live:
            warnings.warn(
                "this copy of an episode has the luck of the original, so a planner that tries strokes on it sees the future; "
                "env.unwrapped.fork(seed) copies with fresh luck",
                stacklevel=2,
            )
        return self._content()

    def __copy__(self) -> Self:
        return copy.deepcopy(self)  # a shallow copy would play into the rally of the original

    def _content(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None, "recorder": None}  # windows and logs belong to one environment

    def fork(self, seed: int | None = None, belief: "Belief" = None) -> Self:
        """Copy with fresh luck, for planning: the same situation, and other outcomes of the strokes to come.

        A fork depends on the seed of the episode and on its own seed alone, and none has the luck of the original, whatever the
        seeds. It shares the action and observation spaces, and opens no window. A hidden position is drawn anew, and a fork does
        not know those of earlier strokes.

        Args:
            seed: seed of the luck from here on, also in later episodes; None: random.
            belief: where the striker believes that the receiver waits, in the game with recovery: a policy, or ``[9]``
                probabilities; None: where people do.

        Raises:
            ResetNeeded: no episode has started.
            OptionError: the seed is no whole number from 0 up to 2^64.
            PolicyError: the belief is no distribution over the feasible positions.
        """
        self._require_begun()
        assert self.last_seed is not None
        shared = {id(space): space for space in (self.action_spaces, self.observation_spaces, self.state_space)}
        twin = object.__new__(type(self))
        twin.__dict__.update(copy.deepcopy(self._content(), shared))
        drawn = secrets.randbits(63) if seed is None else seed_number(seed)
        twin.last_seed = int(stream(drawn, self.last_seed)[0])
        twin._draws = twin._draws_of_episode()
        if self._position is not None and self._stepper.chooses_position(self._state):
            policy = belief if isinstance(belief, Policy) else UniformPolicy() if belief is None else _Believed(belief)
            tables, number = self.game.seats[1 - self._striker], twin._draws.position(self._rally, len(self._strokes))
            score, n = self.score_of(self._striker), self.game.n_strokes
            twin._position = choose(policy, tables, self._state, number, score, self.strokes, waits=True) - n
        twin._positions = [None] * len(self._positions)
        twin.render_mode = None if self.render_mode == "human" else self.render_mode
        return twin

    @property
    def state_number(self) -> int:
        """State index of the striker in :mod:`shuttle_marl.game.tables`, for tables of policies and values."""
        return self._state

    @property
    def chooses_position(self) -> bool:
        """Whether the agent to move is the receiver, who chooses a position, and not the striker."""
        return self._choosing

    @property
    def strokes(self) -> list[int]:
        """Catalogue indices of the strokes of the rally so far; none before a serve."""
        return [] if self._state == ROOT else [played.stroke for played in self._strokes]

    def choice_draw(self) -> int:
        """Random number in [0, 65535) for the next choice of a stroke or position; see :mod:`shuttle_marl.game.draws`.

        It is for who plays a policy, and not for its opponent, who would know a hidden position.
        """
        if self._choosing:
            return self._draws.position(self._rally, len(self._strokes))
        return self._draws.choice(self._rally, 0 if self._state == ROOT else len(self._strokes))

    def score_of(self, player: int) -> tuple[int, int, int, int] | None:  # noqa: ARG002
        """Own points, the opponent's points, own games and the opponent's games; None without a match."""
        return None

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The same object at every call."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start the next episode; with a seed, the first episode of that seed.

        Args:
            seed: a whole number from 0 up to 2^64; None: continue, or a random seed at the first call.
            options: None or empty; those of an episode are options of the constructor, such as ``server``.

        Raises:
            OptionError: another seed, or an option.
        """
        if options != _OF_API_TEST:
            refuse_options(options)
        self._abandon()
        if seed is not None or self.last_seed is None:
            self.last_seed = secrets.randbits(63) if seed is None else seed_number(seed)
            self.episode = -1
        self.episode += 1
        self.agents = list(AGENTS)
        self._clear_episode()
        self._skip_agent_selection = None
        self._length = 0
        self._clear_rally()
        self._begin_rally(self._begin_episode())
        if self.render_mode == "human":
            self.render()

    def observe(self, agent: str) -> Observation:
        """Observation and action mask of an agent; the mask is zero if it is not its turn, and before the first reset."""
        player = _INDEX[agent]
        seen = self._stepper.observe(self._state, receiver=player != self._striker)
        acts = player == self._striker ^ self._choosing
        if acts and self._choosing:
            seen[-1] = 1.0
        mask = self._mask() if self._live and acts else np.zeros(self._stepper.n_actions, np.int8)
        vector = self._vector(seen, player)
        if self._history:
            end = len(vector) - self.game.hides
            vector = np.concatenate([vector[:end], self._last_strokes(player), vector[end:]])
        return {"observation": vector, "action_mask": mask}

    def _last_strokes(self, player: int) -> F32:
        played = self._strokes[::-1] if self._state != ROOT else []
        own, other = ([each.stroke for each in played if each.player == one][: self._history] for one in (player, 1 - player))
        none, n = [self.game.n_strokes] * self._history, self._history
        return stroke_features(self.game)[np.array([(own + none)[:n], (other + none)[:n]])].ravel()

    def state(self) -> F32:
        """Global state, for centralised critics: the observation of ``player_0``, and 1 if it is to strike, else 0.

        In the game with recovery the last number of the observation is replaced: 1 if either player is to choose a position, else
        0. Where a player waits is no part of it.
        """
        found = np.append(self.observe("player_0")["observation"], np.float32(0))
        found[-1 - self.game.hides] = self._choosing
        found[-1] = self._striker == 0
        return found

    def step(self, action: int | None) -> None:
        """Play a stroke, the catalogue index ``action``, or choose position ``action - n``; None for an agent that is done.

        Raises:
            ActionError: not an integer, or not in the action space.
            IllegalStrokeError: not legal in the state; the environment is unchanged.
            ResetNeeded: no episode has started.
        """
        self._require_begun()
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        stroke = self._checked(action)
        if self._choosing:
            self._wait_at(stroke - self.game.n_strokes)
            return
        if self._state == ROOT:
            self._clear_rally()
        striker, draw = self._striker, self._draws.outcome(self._rally, len(self._strokes))
        hurried = self._stepper.is_hurried(self._state)
        played, self._state = self._stepper.step(self._state, striker, stroke, draw, self._position)
        self._strokes.append(played)
        if self.game.hides:
            self._positions.append(self._position)
        outcome = played.outcome
        self._length += 1
        self._cumulative_rewards[agent] = 0.0
        self.rewards = {"player_0": 0.0, "player_1": 0.0}
        self._striker = 1 - striker
        if outcome < RETURNED_BELOW:
            self._live, self._position = False, None
            self.agent_selection = AGENTS[1 - striker]
            self._reason = OUTCOMES[outcome]
            self._winner = striker if outcome != FAULT else 1 - striker
            self._record(self._winner, outcome)
            self._end_rally(self._winner)
        else:
            self._select()
        if self._length == self.max_strokes and not self.terminations[agent]:
            self.truncations = {"player_0": True, "player_1": True}
            if self._reason is None:
                self._reason = REASONS[TOO_LONG]
                self._record(NOBODY, TOO_LONG)
        self._show(striker, stroke, hurried, played)

    def forfeit(self, stroke: int | None = None) -> None:
        """End the episode as a loss of the agent to move, who tried an illegal action, ``stroke`` if it has a number."""
        self._require_begun()
        loser = self._striker ^ self._choosing
        if self._state == ROOT:
            self._clear_rally()
        reason = ILLEGAL_POSITION if self._choosing else ILLEGAL
        self._record(1 - loser, reason)
        self._reason, self._winner = REASONS[reason], 1 - loser
        self._live, self._choosing, self._position = False, False, None
        self._cumulative_rewards[AGENTS[loser]] = 0.0
        self._end_episode(1 - loser)
        self._show(loser, stroke, self._stepper.is_hurried(self._state))

    def render(self) -> U8 | str | None:
        """The rally as text (``ansi``), as a picture from above (``rgb_array``), or in a window (``human``).

        Raises:
            RenderError: pygame is required but not installed.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing; create the environment with render_mode='human', 'rgb_array' or 'ansi'")
            return None
        if self.render_mode == "ansi":
            return as_text(self.snapshot())
        if self._renderer is None:
            self._renderer = CourtRenderer(self.metadata["name"], fps=self.metadata["render_fps"])
        if self.render_mode == "rgb_array":
            return self._renderer.frame(self.snapshot())
        self._renderer.show(self.snapshot())
        return None

    @property
    def _number(self) -> int:
        return 0

    def close(self) -> None:
        """Close the window and finish the log of rallies, if there are any."""
        if self.recorder is not None:
            self._abandon()
            self.recorder.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _record(self, winner: int, reason: int) -> None:
        """Record the rally, which ends here."""
        if self.recorder is None:
            return
        from shuttle_marl.env.recorded import PlayedRally  # noqa: PLC0415

        assert self.last_seed is not None
        server = self._strokes[0].player if self._strokes else self._striker
        where, how = (self.last_seed, self.episode, self._number, self.score_of(0)), (server, winner, reason)
        self.recorder.add_rally(PlayedRally(*where, *how, tuple(self._strokes), tuple(self._positions)))

    def _abandon(self) -> None:
        if self._live and self._state != ROOT and self.agents and not any(self.truncations.values()):
            self._record(NOBODY, ABANDONED)

    def snapshot(self) -> Snapshot:
        """The rally so far, or the last rally until the next serve."""
        between_rallies = self._state == ROOT and bool(self._strokes)
        # A seed tells the luck of both players, with which hidden positions are drawn.
        seed = "" if self.game.hides else f" of seed {self.last_seed}"
        return Snapshot(
            game=self.game,
            names=AGENTS if self.game.people is None else self.game.people.players,
            title=f"{self.metadata['name'].removesuffix('_v0')} {self.episode + 1}{seed}",
            strokes=tuple(self._strokes),
            server=self._strokes[0].player if self._strokes else self._striker,
            striker=self._striker if self._live and not between_rallies else None,
            winner=self._winner,
            reason=self._reason,
            hands=("right", "right") if self.game.people is None else self.game.people.hands,
            positions=() if self._reason is None else tuple(self._positions),
            **self._snapshot_of_match(),
        )

    def _begin_episode(self) -> int:
        """Prepare ``_draws`` and ``_rally``; returns the first server."""
        raise NotImplementedError

    def _draws_of_episode(self) -> RallyDraws:
        raise NotImplementedError

    def _end_rally(self, winner: int) -> None:
        """Count a rally; start the next one or end the episode."""
        self._end_episode(winner)

    def _end_episode(self, winner: int) -> None:
        self._pay(winner)
        self.terminations = {"player_0": True, "player_1": True}

    def _vector(self, row: F32, player: int) -> F32:  # noqa: ARG002
        """The observation of a player, from that of a rally."""
        return row

    def _match_info(self) -> dict[str, Any]:
        return {}

    def _snapshot_of_match(self) -> dict[str, Any]:
        return {}

    def _begin_rally(self, server: int) -> None:
        self._state = ROOT
        self._live = True
        self._striker = server
        self._select()

    def _select(self) -> None:
        """Select who acts in the state: the receiver, if there is a choice of positions, else the striker."""
        self._position = self._stepper.only_position(self._state)
        self._choosing = self._position is None
        self.agent_selection = AGENTS[self._striker ^ self._choosing]

    def _wait_at(self, position: int) -> None:
        self._cumulative_rewards[self.agent_selection] = 0.0
        self.rewards = {"player_0": 0.0, "player_1": 0.0}
        self._choosing, self._position = False, position
        self.agent_selection = AGENTS[self._striker]
        self.infos = {agent: info.copy() for agent, info in self.infos.items()}  # another turn, with the same facts

    def _require_begun(self) -> None:
        if self.last_seed is None:
            raise ResetNeeded("no episode has started; call reset() first")

    def _clear_episode(self) -> None:
        self.rewards = {"player_0": 0.0, "player_1": 0.0}
        self._cumulative_rewards = {"player_0": 0.0, "player_1": 0.0}
        self.terminations = {"player_0": False, "player_1": False}
        self.truncations = {"player_0": False, "player_1": False}
        self.infos = {"player_0": {}, "player_1": {}}

    def _clear_rally(self) -> None:
        self._strokes, self._positions = [], []
        self._reason = self._winner = None

    def _pay(self, winner: int) -> None:
        self.rewards = {AGENTS[winner]: 1.0, AGENTS[1 - winner]: -1.0}
        self._accumulate_rewards()

    def _show(self, striker: int, stroke: int | None, hurried: bool, played: Stroke | None = None) -> None:
        """Set the infos after a stroke, and draw it in the window, if there is one."""
        info = {
            "striker": AGENTS[striker],
            "stroke": None if stroke is None else self.game.action_names[stroke],
            "hurried": hurried,
            "p_succ": played and played.p_succ,
            "p_ret": played and played.p_ret,
            "outcome": played and OUTCOMES[played.outcome],
            "reason": self._reason,
            **self._match_info(),
        }
        self.infos = {"player_0": info, "player_1": info.copy()}
        if self.render_mode == "human":
            self.render()

    def _checked(self, action: Any) -> int:
        try:
            stroke = operator.index(action)
        except TypeError:
            stroke = -1
        if self._choosing:
            if self._stepper.is_feasible(self._state, stroke - self.game.n_strokes):
                return stroke
        elif self._stepper.is_legal(self._state, stroke):
            return stroke
        raise self._refusal(action, stroke)

    def _mask(self) -> I8:
        return self._stepper.position_mask(self._state) if self._choosing else self._stepper.legal_action_mask(self._state)

    def _refusal(self, action: Any, stroke: int) -> ActionError:
        names = self.game.action_names
        if not 0 <= stroke < len(names):
            return ActionError(f"{self.agent_selection}: no action {action!r}; expected an integer from 0 to {len(names) - 1}")
        legal = np.flatnonzero(self._mask()).tolist()
        listed = ", ".join(f"{i} {names[i]}" for i in legal[:_LISTED])
        more = f" and {len(legal) - _LISTED} more" if len(legal) > _LISTED else ""
        kind = "position" if self._choosing else "stroke"
        return IllegalStrokeError(
            f"{self.agent_selection}: {kind} {stroke} ({names[stroke]}) is not legal in state: "
            f"{self.game.describe(self._state)}. Legal, as in action_mask: {listed}{more}",
            stroke,
        )


_OF_API_TEST: Final = {"options": 1}  # options that PettingZoo's conformance test passes to reset


def _stepper(game: Game, outcomes: OutcomesFrom) -> Stepper:
    if outcomes not in get_args(OutcomesFrom):
        raise OptionError(f"outcomes {outcomes!r}: expected one of {', '.join(get_args(OutcomesFrom))}")
    if outcomes == "tables":
        return stepper_of(game)
    with hinted():
        from shuttle_marl.dynamics.compiled import model_stepper  # noqa: PLC0415  torch
    return model_stepper(game)


def refuse_options(options: dict[str, Any] | None) -> None:
    """Refuse options of ``reset``. Raises OptionError: there is one."""
    if options:
        raise OptionError(
            f"options {', '.join(map(repr, options))}: reset has no options; `server` and others are of the constructor"
        )


Belief = Policy | npt.ArrayLike | None  # where a striker believes that the receiver waits; None: where people do


class _Believed(UniformPolicy):
    def __init__(self, belief: npt.ArrayLike) -> None:
        self._belief = np.asarray(belief, dtype=np.float64)

    def positions(self, states: States) -> npt.NDArray[np.float64]:
        return np.broadcast_to(self._belief, (len(states), self._belief.size))

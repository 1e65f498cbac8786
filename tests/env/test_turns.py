"""The turn-based environments beside the plain rule: calls in any order, as a state machine."""

import contextlib
import copy
import functools
import pickle
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.arrays import U64
from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.aec import ShuttleEnv
from shuttle_marl.env.recorded import PlayedRally
from shuttle_marl.game import rules
from shuttle_marl.game.draws import draw, first_server, outcome_draw, stream
from shuttle_marl.game.layout import RALLY_WIDTH, observations
from shuttle_marl.game.rules import FAULT, RETURNED_BELOW, WINNER, IllegalStrokeError
from shuttle_marl.game.scoring import Rules, Score
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import tiring_game
from tests.recovery import with_recovery

AGENTS = ("player_0", "player_1")
RULES = Rules(points=2, clear=1, cap=2, games=2)
SEEDS = st.integers(0, 50)


@functools.cache
def game_of(hidden: bool) -> Game:
    return with_recovery(tiring_game(), 3, 3) if hidden else tiring_game()


class Turns(RuleBasedStateMachine):
    """An environment, and the episode by ``game.rules`` and ``game.scoring`` alone."""

    @initialize(
        hidden=st.booleans(), reward=st.sampled_from([None, "match", "rally"]), cut=st.none() | st.integers(1, 9), seed=SEEDS
    )
    def make(self, hidden: bool, reward: Any, cut: int | None, seed: int) -> None:
        """A rally has no score, and a match pays by its ``reward``."""
        self.game, self.reward, self.cut = game_of(hidden), reward, cut
        self.rallies: list[PlayedRally] = []
        self.ended = 0
        options: dict[str, Any] = {"game": self.game, "max_strokes": cut}
        made = rally_v0.raw_env(**options) if reward is None else match_v0.raw_env(reward=reward, rules=RULES, **options)
        self.env: ShuttleEnv = made
        self.env.recorder = cast(Any, self)
        self.reset(seed)

    def add_rally(self, rally: PlayedRally) -> None:
        if rally.reason in (FAULT, WINNER):
            self.rallies.append(rally)

    def close(self) -> None:
        raise AssertionError

    @rule(seed=st.none() | SEEDS)
    def reset(self, seed: int | None) -> None:
        self.env.reset(seed=seed)
        if seed is not None:
            self.seed, self.episode = seed, -1
        self.episode += 1
        self.over: str | None = None
        self.strokes, self.rally, self.count, self.owed = 0, 0, 0, [0, 0]
        server = int(first_server(self.bits())[0])
        self.score = None if self.reward is None else Score(server=server, rules=RULES)
        self.serve(server)

    def bits(self) -> U64:
        """Random bits of the next stroke."""
        return draw(stream(self.seed, self.episode, *([] if self.reward is None else [self.rally])), self.count)

    def serve(self, server: int) -> None:
        self.striker, self.seen, self.count = server, rules.serve(self.game), 0
        self.waited: list[int | None] = []
        self.arrive()

    def arrive(self) -> None:
        """The shuttle was returned: the receiver chooses between several positions, or has one."""
        self.state = int(self.game.state_of(*self.seen))
        self.feasible = rules.legal_positions(self.game, self.seen)
        self.choosing, self.position = len(self.feasible) > 1, self.feasible[0]

    @property
    def actor(self) -> int:
        return self.striker ^ self.choosing

    def legal(self) -> list[int]:
        if self.choosing:
            return [self.game.n_strokes + position for position in self.feasible]
        return rules.legal_strokes(self.game, self.seen)

    @precondition(lambda self: not self.over)
    @rule(data=st.data(), times=st.integers(1, 8))
    def act(self, data: st.DataObject, times: int) -> None:
        for _ in range(times):
            self.is_the_rule()
            if not self.over:
                self.play(data.draw(st.sampled_from(self.legal())))

    def play(self, action: int) -> None:
        self.owed[self.actor] = 0
        self.env.step(action)
        if self.choosing:
            self.choosing, self.position = False, action - self.game.n_strokes
            return
        drawn = int(outcome_draw(self.bits())[0])
        outcome = rules.outcome(self.game, self.striker, self.seen, action, self.position, drawn)
        self.waited.append(self.position)
        self.striker, self.count, self.strokes = 1 - self.striker, self.count + 1, self.strokes + 1
        if outcome < RETURNED_BELOW:
            self.ended += 1
            self.won(self.striker ^ (outcome == WINNER))
        else:
            self.seen = rules.next_state(self.game, self.seen, action, outcome)
            self.arrive()
        if self.strokes == self.cut and not self.over:
            self.over = "truncated"

    def won(self, winner: int) -> None:
        self.score = None if self.score is None else self.score.after(winner)
        self.over = "terminated" if self.score is None or self.score.over else None
        if self.over or self.reward == "rally":
            self.pay(winner)
        if not self.over:
            self.rally += 1
            self.serve(winner)

    def pay(self, winner: int) -> None:
        self.owed[winner] += 1
        self.owed[1 - winner] -= 1

    @precondition(lambda self: not self.over)
    @rule()
    def forfeit(self) -> None:
        loser = self.actor
        self.env.forfeit()
        self.owed[loser] = 0
        self.pay(1 - loser)
        assert self.env.infos[AGENTS[loser]]["reason"] == ("illegal position" if self.choosing else "illegal stroke")
        self.over, self.waited = "terminated", [*self.waited]

    def told(self) -> bytes:
        env = self.env
        return pickle.dumps([[env.observe(agent) for agent in AGENTS], env.rewards, env.infos, env.terminations, env.state()])

    @precondition(lambda self: not self.over)
    @rule(data=st.data())
    def illegal(self, data: st.DataObject) -> None:
        """It is refused, and nothing changes."""
        n = len(self.game.action_names)
        wrong = sorted({*range(-1, n + 1)} - {*self.legal()})
        action, before = data.draw(st.sampled_from([*wrong, None, "smash", 1.0])), self.told()
        with pytest.raises(ActionError) as refused:
            self.env.step(action)
        assert isinstance(refused.value, IllegalStrokeError) == (isinstance(action, int) and 0 <= action < n)
        assert self.told() == before

    @precondition(lambda self: self.env.agents)
    @rule(seed=SEEDS)
    def fork(self, seed: int) -> None:
        """A copy with other luck; what happens in it stays there."""
        before, fork = self.told(), self.env.fork(seed)
        assert np.array_equal(fork.state(), self.env.state())
        assert fork.choice_draw() != self.env.choice_draw()
        while not (fork.terminations[AGENTS[0]] or fork.truncations[AGENTS[0]]):
            fork.step(int(fork.observe(fork.agent_selection)["action_mask"].argmax()))
        assert self.told() == before

    @rule(copied=st.sampled_from([copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]))
    def go_on_with_a_copy(self, copied: Any) -> None:
        """An exact copy has the luck of the original, and warns in an episode."""
        with pytest.warns(UserWarning, match="sees the future") if not self.over else contextlib.nullcontext():
            self.env = copied(self.env)
        self.env.recorder = cast(Any, self)

    @precondition(lambda self: self.over and self.env.agents)
    @rule()
    def leave(self) -> None:
        with pytest.raises(ValueError, match="only valid action is None"):
            self.env.step(0)
        for agent in self.env.agent_iter():
            assert self.env.last()[1] == self.owed[AGENTS.index(agent)]
            self.env.step(None)
        assert self.env.agents == []

    @invariant()
    def is_the_rule(self) -> None:
        env = self.env
        assert (env.last_seed, env.episode, len(self.rallies)) == (self.seed, self.episode, self.ended)
        if env.agents:
            for found, what in ((env.terminations, "terminated"), (env.truncations, "truncated")):
                assert found == dict.fromkeys(AGENTS, self.over == what)
        if self.score is not None:
            points, games = self.score.by_game[-1] if self.over else self.score.points, self.score.games
            assert env.score_of(1) == (*points[::-1], *games[::-1])
            server = [self.score.server == 1, self.score.server == 0]
            expected = [*np.array(points[::-1]) / RULES.cap, *np.array(games[::-1]) / RULES.games, *server]
            assert self.over or env.observe(AGENTS[1])["observation"][RALLY_WIDTH : RALLY_WIDTH + 6].tolist() == expected
        if self.reward is None:
            assert env.snapshot().positions == (tuple(self.waited) if self.over and self.game.hides else ())
        if self.over:
            return
        assert (env.state_number, env.chooses_position, env.agent_selection) == (self.state, self.choosing, AGENTS[self.actor])
        assert env.last()[1] == self.owed[self.actor]
        seen = [env.observe(agent) for agent in AGENTS]
        assert np.flatnonzero(seen[self.actor]["action_mask"]).tolist() == self.legal()
        assert not seen[1 - self.actor]["action_mask"].any()
        expected = observations(self.game, np.array([self.state]))[0]
        assert np.array_equal(seen[self.striker]["observation"][:RALLY_WIDTH], expected)
        assert env.state()[-1] == (self.striker == 0)
        if self.game.hides:
            assert [one["observation"][-1] for one in seen] == [self.choosing and seat == self.actor for seat in (0, 1)]


TestTurns = Turns.TestCase
TestTurns.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)

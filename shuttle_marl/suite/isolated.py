"""Methods that run as programs of their own, and see states, legal strokes and rewards alone (:mod:`.program`)."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import Ints
from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.base.files import cache_folder
from shuttle_marl.base.programs import Program
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game.observation import observations
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.suite import program
from shuttle_marl.suite.exploit import OPPONENT, PlayerSetting, Trained
from shuttle_marl.suite.method import Method
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.robust import RobustSetting

_PACKAGE: Final = Path(__file__).parents[1]
_MOST_RALLIES: Final = 1 << 16


def isolated(name: str) -> Method:
    """A method ``MODULE:ATTRIBUTE``, called with a setting as those of :func:`shuttle_marl.suite.method.find` are.

    It returns a trained player, or the object that the method made, and raises SuiteError if the method failed or the task gives
    tables.
    """

    def method(setting: Any) -> Any:
        if isinstance(setting, RobustSetting):
            raise SuiteError("robust-v0 gives the tables of games, so its methods cannot be isolated")
        started = IsolatedMethod(name, setting)
        if not isinstance(setting, PlayerSetting):
            return started
        player = started.player(call="player")
        return Trained(player=player, strokes=started.used)

    return method


class IsolatedMethod:
    """A method in a process of its own; :attr:`used` counts the strokes of the learner."""

    def __init__(self, name: str, setting: Any) -> None:
        self._setting, self.game, self.used = setting, setting.game, 0
        closed = [_PACKAGE, setting.folder / OPPONENT, *([] if (cache := cache_folder()) is None else [cache])]
        command = [sys.executable, "-I", program.__file__, name, *map(str, (Path.cwd(), *(path.resolve() for path in closed)))]
        self._program = Program(command, shown=True)
        states = np.arange(self.game.n_states)
        self._send(
            observation=observations(self.game, states),
            mask=self.game.mask(states),
            seed=setting.seed,
            budget=setting.budget if isinstance(setting, PlayerSetting) else 0,
            folder=str(setting.folder.resolve()),
        )

    def _send(self, **arrays: Any) -> None:
        self._program.write(program.message(**arrays))

    def _ask(self, **request: Any) -> dict[str, Any]:
        """Send a request, and serve those of the method until it answers."""
        self._send(**request)
        while True:
            try:
                answer = program.receive(self._program)
            except (ValueError, OSError) as error:
                raise SuiteError(f"the isolated method sent an invalid message: {error}") from error
            served = {"reset", "step", "policy"} & answer.keys()
            if not served:
                break
            try:
                reply = getattr(self, f"_{served.pop()}")(answer)
            except (ShuttleError, ValueError, IndexError) as error:
                reply = {"error": str(error)}
            self._send(**reply)
        if "error" in answer:
            raise SuiteError(f"the isolated method raised {printable(str(answer['error']))}")
        return answer

    def _reset(self, request: dict[str, Any]) -> dict[str, Any]:
        number, setting = int(request["reset"]), self._setting
        if not isinstance(setting, PlayerSetting) or not 1 <= number <= _MOST_RALLIES:
            raise SuiteError(f"{number} rallies: tasks that train players have 1 to {_MOST_RALLIES} at once")
        if setting.opponent is None:
            self._batch: RallyBatch | RallyVectorEnv = RallyBatch(self.game, number, seed=setting.seed)
        else:
            self._batch = RallyVectorEnv(number, opponent=setting.opponent, game=self.game, mask="none", info="none")
            self._batch.reset(seed=setting.seed)
        return {"state": self._states()}

    def _states(self) -> Ints:
        return (self._batch if isinstance(self._batch, RallyBatch) else self._batch.versus).rows.state

    def _step(self, request: dict[str, Any]) -> dict[str, Any]:
        strokes, batch = request["step"], self._batch
        if self.used + len(strokes) > self._setting.budget:
            raise SuiteError(f"the budget of {self._setting.budget:,} strokes is used up")
        reward, over = batch.step(strokes) if isinstance(batch, RallyBatch) else batch.step(strokes)[1:3]
        self.used += len(strokes)
        return {"state": self._states(), "reward": reward, "over": over}

    def _policy(self, request: dict[str, Any]) -> dict[str, Any]:
        row, pair = self.game.pairs(request["state"])
        chance = np.zeros((len(request["state"]), self.game.n_strokes), dtype=np.float32)
        chance[row, self.game.pair_stroke[pair]] = self._policies[int(request["policy"])].probability_of(pair)
        return {"probability": chance}

    def player(self, **request: Any) -> TabulatedPolicy:
        """The policy that the method answers with."""
        answer, game = self._ask(**request), self.game
        row, pair = game.pairs(np.arange(game.n_states))
        if (strokes := answer.get("stroke", np.zeros(0))).shape == (game.n_states,):
            chance = (strokes[row] == game.pair_stroke[pair]).astype(np.float64)
        elif (given := answer.get("probability", np.zeros(0))).shape == (game.n_states, game.n_strokes):
            chance = given[row, game.pair_stroke[pair]].astype(np.float64)
        else:
            raise SuiteError(
                "an isolated method returns an object with act(observation, mask) or probabilities(observation, mask), not a "
                f"{next(iter(answer))}"
            )
        if not (chance >= 0).all():
            raise SuiteError("the isolated method returned probabilities below 0, or none")
        return from_pair_probabilities(game, chance)

    def _arrays(self, data: Any) -> dict[str, Any]:
        """Columns of strokes; the stroke stands for the pair, which only the tables number."""
        names = [field.name for field in dataclasses.fields(data) if field.name not in ("game", "pair")]
        return {"stroke": self.game.pair_stroke[data.pair], **{name: np.asarray(getattr(data, name)) for name in names}}

    def fit(self, data: Any) -> TabulatedPolicy:
        """Learn from strokes."""
        return self.player(call="fit", **self._arrays(data))

    def estimate(self, log: Any, policies: list[TabulatedPolicy]) -> Any:
        """Values of policies."""
        self._policies = policies
        return self._ask(call="estimate", policies=len(policies), **self._arrays(log)).get("values")

    def answer(self, position: Any) -> Any:
        """The name of a stroke."""
        return str(self._ask(call="answer", position=json.dumps(position)).get("text"))

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """What is played next."""
        return self.player(call="policy_for_next_rally")

    def observe_rally(self, rally: Any) -> None:
        """A rally that was played."""
        self._ask(call="observe_rally", **self._arrays(rally))

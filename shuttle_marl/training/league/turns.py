"""A turn of one learner: from its last state, against frozen opponents, to its next state and a frozen policy.

What a turn does follows from its settings and the files that it reads alone, so it does not matter which process takes it, and
what else runs. It leaves its results in files of its own, the description last: a turn that is there whole is not taken again.
"""

import dataclasses
import hashlib
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from safetensors.numpy import save as save_arrays
from safetensors.torch import load, save

from shuttle_marl import exact
from shuttle_marl.files import FileReadError, open_file, read_sealed, replace_file, seal
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy.network import PolicyNetwork
from shuttle_marl.training.a2c import A2CConfig, make_a2c
from shuttle_marl.training.collecting import SEEDS, RallyCollector
from shuttle_marl.training.config import SELF, TrainingConfig
from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.matchmaking import order
from shuttle_marl.training.league.population import Tables
from shuttle_marl.training.learner import DivergedError, Learner, Tensors, check_finite
from shuttle_marl.training.networks import tabulated, weights_of
from shuttle_marl.training.ppo import PPOConfig, make_ppo
from shuttle_marl.training.sac import SACConfig, make_sac

LEARNERS: Final = "learners"
"""Folder of the states of learners in the folder of a run."""
_MAKE: Final[dict[str, Callable[[Any, Game], Learner]]] = {"ppo": make_ppo, "a2c": make_a2c, "sac": make_sac}
_CONFIGS: Final[dict[str, type[TrainingConfig]]] = {"ppo": PPOConfig, "a2c": A2CConfig, "sac": SACConfig}
_TOLERANCE: Final = 1e-4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Turn:
    """Settings of one turn.

    Attributes:
        member: name of the learner, such as ``main-agent-0``.
        round: counted from 1.
        fresh: whether it begins with new weights.
        opponents: hashes of tables.
        shares: of its rallies, by opponent; what they and ``responses`` lack to 1 it plays against itself.
        responses: share of its rallies against the exact best response to it.
        strokes: least number of its strokes; None: ``seconds`` decides.
        seconds: of learning; what is made before and after comes on top.
        remaining: share of the learner's whole schedule that is left at the beginning and at the end.
        seed: of all draws.
    """

    member: str
    round: int
    fresh: bool
    opponents: tuple[str, ...]
    shares: tuple[float, ...]
    responses: float
    strokes: int | None
    seconds: float | None
    remaining: tuple[float, float]
    seed: int

    def as_json(self) -> dict[str, Any]:
        """The settings as JSON."""
        fields: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self)))
        return fields


@dataclasses.dataclass(frozen=True, kw_only=True)
class Taken:
    """Results of a turn.

    Attributes:
        member: name of the learner.
        hash: of its table at the end.
        strokes: of the learner in the turn.
        seconds: of learning.
        iterations: of the turn.
    """

    member: str
    hash: str
    strokes: int
    seconds: float
    iterations: int


def take_turn(folder: Path, config: LeagueTrainingConfig, turn: Turn, game: Game | None = None) -> Taken:
    """Take a turn, or read its results where it was taken already.

    Args:
        folder: of the run.
        config: of the league.
        turn: the turn.
        game: of the league; None: found by its name.

    Raises:
        DivergedError: a weight or a loss became no finite number.
        LeagueTrainingError: a file that the turn needs is missing or damaged.
    """
    done = results(folder, turn)
    if done is not None:
        return done
    return _Turn(folder, config, turn, resolve_game(config.game, config.profile) if game is None else game).take()


def needed(turn: Turn) -> list[Path]:
    """Files in the folder of a run that a turn reads."""
    before = [] if turn.fresh else _paths(Path(), turn.member, turn.round - 1)
    return [*(Tables.path(Path(), name) for name in turn.opponents), *before]


def made(turn: Turn, taken: Taken) -> list[Path]:
    """Files in the folder of a run that a turn leaves, the one that says that all are there last."""
    about, state = _paths(Path(), turn.member, turn.round)
    return [Tables.path(Path(), taken.hash), network_path(Path(), turn.member, turn.round), state, about]


def network_path(folder: Path, member: str, number: int) -> Path:
    """File of the network of a learner after a round."""
    return folder / LEARNERS / f"{member}-{number}.network.safetensors"


def forget(folder: Path, before: int) -> None:
    """Delete the states of learners of the rounds before one; their frozen policies and networks stay."""
    for path in (folder / LEARNERS).glob("*.state.safetensors"):
        if int(path.name.partition(".")[0].rpartition("-")[2]) < before:
            path.unlink(missing_ok=True)


def results(folder: Path, turn: Turn) -> Taken | None:
    """The results of a turn that was taken; None if they are not there, or not whole."""
    about_path, state_path = _paths(folder, turn.member, turn.round)
    try:
        about = read_sealed(about_path)
    except FileReadError:
        return None
    if about.get("turn") != turn.as_json() or not state_path.exists():
        return None
    return Taken(**about["taken"])


def _paths(folder: Path, member: str, number: int) -> tuple[Path, Path]:
    stem = folder / LEARNERS / f"{member}-{number}"
    return stem.with_name(f"{stem.name}.json"), stem.with_name(f"{stem.name}.state.safetensors")


def learner_config(config: LeagueTrainingConfig, *, self_play: bool) -> TrainingConfig:
    """Settings of the learners of a league.

    Args:
        config: of the league.
        self_play: whether the learner meets itself alone, or may (ppo and a2c): then what follows a stroke is the opponent's.
    """
    changed: dict[str, Any] = {"width": config.width, "opponent": (SELF,) if self_play else ("bc",)}
    if config.algorithm != "sac":
        changed["entropy"] = config.entropy
    if config.algorithm == "ppo":
        changed["sharpen_after"] = 1.0  # a policy is frozen in every round, and played at the temperature that suits it best
    if config.learning_rate is not None:
        changed["learning_rate"] = config.learning_rate
    if config.batch:
        changed["batch"] = config.batch
    return _CONFIGS[config.algorithm](**changed)


class _Turn:
    def __init__(self, folder: Path, config: LeagueTrainingConfig, turn: Turn, game: Game) -> None:
        torch.set_num_threads(1)
        self.folder, self.config, self.turn, self.game = folder, config, turn, game
        self.tables = Tables(folder, game)
        opponents = [self.tables.read(name) for name in turn.opponents]
        # The best response has the last place; before it is solved, any policy keeps the place.
        response = [_first_stroke(self.game)] if turn.responses else []
        alone = not opponents and not response
        settings = learner_config(config, self_play=alone or config.algorithm != "sac")
        torch.manual_seed(turn.seed % SEEDS)
        self.learner = _MAKE[config.algorithm](settings, self.game)
        met = [*opponents, *response]
        self.collector = RallyCollector(settings, self.game, met, self.learner.assess, distinct=self.learner.distinct)
        if not turn.fresh:
            self._restore()
        self.collector.begin(turn.seed)
        if met:
            shares = [*turn.shares, *([turn.responses] if turn.responses else [])]
            self.collector.sampler.assign(order(shares))

    def take(self) -> Taken:
        """Collect and learn until the turn is over, then save."""
        turn, strokes, iterations = self.turn, 0, 0
        self.begun = time.monotonic()
        with ThreadPoolExecutor(1) as solver:
            pending: Future[TabulatedPolicy] | None = None
            share = 0.0
            while share < 1:
                if turn.responses and iterations % self.config.renew == 0:
                    # Solved beside learning, and used a fixed number of iterations later, however long it takes.
                    pending = self._renew(solver, pending)
                first, last = turn.remaining
                remaining = first + (last - first) * share
                self.learner.begin(remaining)
                try:
                    data = self.collector.collect()
                    self.learner.learn(data, remaining)
                    self.learner.check_weights()
                except DivergedError as error:
                    raise DivergedError(
                        f"{turn.member} in round {turn.round}: learning diverged ({error}); train again with a lower "
                        "--learning-rate"
                    ) from error
                strokes += self.collector.strokes
                iterations += 1
                share = self._share(strokes)
        return self._save(strokes, iterations, round(time.monotonic() - self.begun, 2))

    def _share(self, strokes: int) -> float:
        """Part of the turn that is done."""
        if self.turn.strokes is not None:
            return strokes / self.turn.strokes
        return (time.monotonic() - self.begun) / max(self.turn.seconds or 0.0, 1e-9)

    def _renew(self, solver: ThreadPoolExecutor, pending: Future[TabulatedPolicy] | None) -> Future[TabulatedPolicy]:
        weights = weights_of(self.learner.actor)
        solved = solver.submit(_response, weights, self.game)
        ready = solved if pending is None else pending
        self.collector.sampler.replace_opponent(len(self.turn.opponents), ready.result())
        return solved

    def _restore(self) -> None:
        """Take over the learner's state after the round before.

        Raises:
            LeagueTrainingError: it is missing or damaged.
        """
        about_path, path = _paths(self.folder, self.turn.member, self.turn.round - 1)
        try:
            about = read_sealed(about_path)
            with open_file(path) as file:
                content = file.read()
            if about.get("sha256") != hashlib.sha256(content).hexdigest():
                raise FileReadError("it does not fit its hash")
            state = load(content)
            self.learner.restore(state)
            parts = ((name, state[f"collector.{name}"]) for name in ("known", "iteration"))
            self.collector.load_state_dict(OrderedDict(parts))
        except (OSError, FileReadError, KeyError, ValueError, RuntimeError) as error:
            raise LeagueTrainingError(f"{path}: cannot be used ({error}); train again with --overwrite") from error

    def _save(self, strokes: int, iterations: int, seconds: float) -> Taken:
        turn = self.turn
        collected = {f"collector.{name}": part for name, part in self.collector.state_dict().items()}
        state: Tensors = self.learner.state() | collected
        check_finite(state.values())
        content = save({name: tensor.clone() for name, tensor in state.items()})
        about_path, path = _paths(self.folder, turn.member, turn.round)
        name = self.tables.keep(tabulated(self.learner.played, self.game))
        replace_file(network_path(self.folder, turn.member, turn.round), save_arrays(weights_of(self.learner.played)))
        replace_file(path, content)
        taken = Taken(member=turn.member, hash=name, strokes=strokes, seconds=seconds, iterations=iterations)
        about = {"turn": turn.as_json(), "taken": dataclasses.asdict(taken), "sha256": hashlib.sha256(content).hexdigest()}
        replace_file(about_path, seal(about))
        return taken


def _response(weights: dict[str, Any], game: Game) -> TabulatedPolicy:
    """The best response to a network."""
    return exact.best_response(PolicyNetwork.of_tensors(weights, game).table(game), tolerance=_TOLERANCE).policy


def _first_stroke(game: Game) -> TabulatedPolicy:
    """The policy that plays the first legal stroke everywhere."""
    return TabulatedPolicy(game=game, cumulative=np.full(game.n_pairs, np.iinfo(np.uint16).max, np.uint16))

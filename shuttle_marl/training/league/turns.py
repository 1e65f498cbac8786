"""Turns of a league: a learner continues from its last state against frozen opponents, and its new policy is frozen.

The result of a turn depends on its settings and its input files alone, so it does not matter which process takes it. It writes
its output files, the description last; completed turns are skipped on resume. On a cluster no folder is shared: input files are
sent with a turn, and output files are sent back.
"""

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import save
from safetensors.torch import load

from shuttle_marl import exact
from shuttle_marl.base.cluster import Cluster, WorkerPool
from shuttle_marl.base.files import FileReadError, hash_in, read_hashed, read_json, read_sealed, replace_file, replace_with_card
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.base.runs import check_interrupt, interrupts_held
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import StoredPolicies, policy_file
from shuttle_marl.policy.network import PolicyNetwork
from shuttle_marl.recording import Player
from shuttle_marl.training.config import CONFIGS, SEEDS, SELF, TrainingConfig
from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.population import TABLES, Turn, TurnResult
from shuttle_marl.training.league.schedule import order
from shuttle_marl.training.learner import Callback, Learner, stored
from shuttle_marl.training.networks import DivergedError, tabulated, weights_of
from shuttle_marl.training.rally_log import RunLog
from shuttle_marl.training.run import LEARNERS as ALGORITHMS

T = TypeVar("T")

RALLIES: Final = "rallies"
LEARNERS: Final = "learners"
_ABOUT, _STATE, NETWORK = "json", "state.safetensors", "network.safetensors"
_TOLERANCE: Final = 1e-4
_PATIENCE: Final = 0.2  # longest time after which Ctrl-C is noticed while workers compute [s]
_ATTEMPTS: Final = 3


def take_turn(folder: Path, config: LeagueTrainingConfig, turn: Turn, game: Game | None = None) -> TurnResult:
    """Take a turn, or read its result if it is complete.

    Args:
        game: game of the league; None: it is resolved by its name.

    Raises:
        DivergedError: a weight or a loss became infinite or NaN.
        LeagueTrainingError: an input file is missing or damaged.
    """
    result = completed(folder, turn)
    if result is not None:
        return result
    with interrupts_held(), own_settings(1):
        return _Turn(folder, config, turn, resolve_game(config.game, config.profile) if game is None else game).take()


def turn_file(folder: Path, member: str, number: int, kind: str) -> Path:
    """File of a learner after a round: ``json`` (description), ``state.safetensors`` or ``network.safetensors``."""
    return folder / LEARNERS / f"{member}-{number}.{kind}"


def prune_states(folder: Path, before: int) -> None:
    """Delete the states of learners of rounds before one; frozen policies and networks are not deleted."""
    for path in (folder / LEARNERS).glob("*.state.safetensors"):
        if int(path.name.partition(".")[0].rpartition("-")[2]) < before:
            path.unlink(missing_ok=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Completed:
    """Description of a completed turn in its file: settings and result."""

    turn: Turn
    result: TurnResult


def completed(folder: Path, turn: Turn) -> TurnResult | None:
    """The result of a completed turn; None if its files are missing or damaged."""
    try:
        about = read_json(turn_file(folder, turn.member, turn.round, _ABOUT), Completed, sealed=True)
    except FileReadError:
        return None
    return about.result if about.turn == turn and turn_file(folder, turn.member, turn.round, _STATE).exists() else None


def _learner_config(config: LeagueTrainingConfig, *, self_play: bool) -> TrainingConfig:
    """Settings of a learner; ``self_play``: whether gamma is -1, because it may play against itself."""
    changed: dict[str, Any] = {"width": config.width, "opponent": (SELF,) if self_play else ("bc",)}
    if config.algorithm != "sac":
        changed["entropy"] = config.entropy
    if config.algorithm == "ppo":
        changed["anneal_after"] = 1.0  # frozen policies are evaluated at several temperatures instead
    if config.learning_rate is not None:
        changed["learning_rate"] = config.learning_rate
    if config.batch:
        changed["batch"] = config.batch
    return CONFIGS[config.algorithm](**changed)


class _Turn(Callback):
    def __init__(self, folder: Path, config: LeagueTrainingConfig, turn: Turn, game: Game) -> None:
        self.folder, self.config, self.turn, self.game = folder, config, turn, game
        self.tables = StoredPolicies(folder / TABLES, game)
        opponents = [self.tables.read(name) for name in turn.opponents]
        if turn.response_fraction:  # replaced by the best response before the first iteration
            opponents.append(_first_stroke(game))
        settings = _learner_config(config, self_play=not opponents or config.algorithm != "sac")
        with InitialWeights(turn.seed % SEEDS):
            self.learner = ALGORITHMS[config.algorithm](settings, game, opponents)
        self.pending: Future[TabulatedPolicy] | None = None
        if not turn.fresh:
            self._restore()
        self.learner.collector.set_seed(turn.seed)
        if opponents:
            responses = [turn.response_fraction] if turn.response_fraction else []
            self.learner.collector.sampler.assign(order([*turn.fractions, *responses]))

    def take(self) -> TurnResult:
        turn = self.turn
        others = [Player(name=f"frozen-{name[:12]}", hash=name) for name in turn.opponents]
        others += [Player(name="best-response")] if turn.response_fraction else []
        path, players = self.folder / RALLIES / f"{turn.member}-{turn.round}.mcap", (Player(name=turn.member), *others)
        recorded = path if self.config.record == "all" else None
        self.log = RunLog(recorded, self.game, players, [turn.seed % SEEDS], seed=turn.seed)
        first, last = turn.remaining
        with self.log, ThreadPoolExecutor(1) as self.solver:
            try:
                while (progress := self.learner.strokes / turn.strokes) < 1:
                    check_interrupt()
                    self.learner.iterate(first + (last - first) * progress, self)
            except DivergedError as error:
                raise DivergedError(
                    f"{turn.member} in round {turn.round}: learning diverged ({error}); train again with a lower --learning-rate"
                ) from error
        return self._save()

    def begin(self, learner: Learner) -> None:
        """Replace the last opponent by a best response; it is solved in parallel, and used one interval later."""
        if not self.turn.response_fraction or learner.iteration % self.config.update_interval:
            return
        solved = self.solver.submit(_best_response, weights_of(learner.actor), self.game)
        ready, self.pending = self.pending or solved, solved
        learner.collector.sampler.replace_opponent(len(self.turn.opponents), ready.result())

    def collected(self, learner: Learner) -> None:
        self.log.record(learner.collector.sampler, 0, learner.iteration - 1)

    def learned(self, learner: Learner, losses: dict[str, float]) -> None:  # noqa: ARG002
        self.log.settle()

    def _restore(self) -> None:
        """Restore the state of the learner after the previous round."""
        path, about = (turn_file(self.folder, self.turn.member, self.turn.round - 1, kind) for kind in (_STATE, _ABOUT))
        try:
            self.learner.load_state_dict(load(read_hashed(path, hash_in(read_sealed(about), path.name))))
        except (OSError, FileReadError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
            raise LeagueTrainingError(f"{path}: cannot be used ({error}); train again with --overwrite") from error

    def _save(self) -> TurnResult:
        turn, learner, policy = self.turn, self.learner, self.learner.eval_actor
        state = learner.state_dict()
        state_path, about_path, network_path = (
            turn_file(self.folder, turn.member, turn.round, kind) for kind in (_STATE, _ABOUT, NETWORK)
        )
        name = self.tables.save(tabulated(policy, self.game))
        replace_file(network_path, save(weights_of(policy)))
        result = TurnResult(member=turn.member, hash=name, strokes=learner.strokes)
        about = {"turn": dataclasses.asdict(turn), "result": dataclasses.asdict(result)}
        replace_with_card(about_path, about, {state_path.name: stored(state)})
        return result


def _best_response(weights: dict[str, Any], game: Game) -> TabulatedPolicy:
    return exact.best_response(PolicyNetwork.of_tensors(weights, game).table(game), tolerance=_TOLERANCE).policy


def _first_stroke(game: Game) -> TabulatedPolicy:
    return TabulatedPolicy(game=game, cumulative=np.full(game.n_pairs, np.iinfo(np.uint16).max, np.uint16))


class Workers:
    """Processes (1: this one), or a cluster, that take turns in parallel; the results do not depend on them."""

    def __init__(self, count: int, game: Game, cluster: Cluster | None = None) -> None:
        self._count, self._cluster = count, cluster
        self._game = None if cluster is None else cluster.share(game)
        self._pool: WorkerPool | None = None

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is not None:
            self._pool.__exit__(kind)

    def take(self, folder: Path, config: LeagueTrainingConfig, turns: Sequence[Turn]) -> list[TurnResult]:
        """Take turns; those of a worker that dies are repeated. Raises LeagueTrainingError, ClusterError: lost repeatedly."""
        if self._cluster is not None:
            return self._take_on(self._cluster, folder, config, turns)
        if self._count == 1 or len(turns) == 1:
            return [take_turn(folder, config, turn) for turn in turns]
        for _ in range(_ATTEMPTS):
            try:
                waiting = [self._submit(take_turn, folder, config, turn) for turn in turns]
                return [_result(future) for future in waiting]
            except BrokenProcessPool:
                # A worker that was starting when another one died can outlive the pool, which would wait for it forever.
                if self._pool is not None:
                    self._pool.kill()
                self._pool = None
        raise LeagueTrainingError(
            f"{folder}: workers died {_ATTEMPTS} times in one round, perhaps for lack of memory; continue with --resume and "
            "fewer --workers"
        )

    def _take_on(self, cluster: Cluster, folder: Path, config: LeagueTrainingConfig, turns: Sequence[Turn]) -> list[TurnResult]:
        tasks: list[Callable[[], dict[Path, bytes]]] = []
        for turn in [turn for turn in turns if completed(folder, turn) is None]:
            read = [policy_file(Path(TABLES), name) for name in turn.opponents]
            if not turn.fresh:
                read += [turn_file(Path(), turn.member, turn.round - 1, kind) for kind in (_STATE, _ABOUT)]
            files = {path: (folder / path).read_bytes() for path in read}
            tasks.append(cluster.submit(take_remotely, config, turn, self._game, files))
        for task in tasks:
            for path, content in task().items():
                replace_file(folder / path, content)
        return [take_turn(folder, config, turn) for turn in turns]

    def _submit(self, function: Callable[..., T], *arguments: Any) -> Future[T]:
        """Submit a call to the pool, which is started if there is none."""
        try:
            if self._pool is None:
                self._pool = WorkerPool(self._count)
            return self._pool.submit(function, *arguments)
        except OSError as error:  # the pool closed its pipes while another worker was starting
            raise BrokenProcessPool(str(error)) from error


def _result(future: Future[T]) -> T:
    while not wait([future], timeout=_PATIENCE).done:
        check_interrupt()
    return future.result()


def take_remotely(config: LeagueTrainingConfig, turn: Turn, game: Game, files: dict[Path, bytes]) -> dict[Path, bytes]:
    """Take a turn without the run folder; ``files``: what it reads, by paths in it; returns what it writes, description last."""
    with tempfile.TemporaryDirectory(prefix="shuttle-marl-") as name:
        folder = Path(name)
        for path, content in files.items():
            replace_file(folder / path, content)
        take_turn(folder, config, turn, game)
        found = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        return {path: found[path] for path in sorted(found.keys() - files.keys(), key=lambda path: path.suffix == ".json")}

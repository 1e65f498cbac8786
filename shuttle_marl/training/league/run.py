"""League training: rounds of turns; policies are frozen, evaluated exactly and saved after each round."""

import contextlib
import dataclasses
import json
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from shuttle_marl import exact
from shuttle_marl.base import runs
from shuttle_marl.base.cluster import Cluster, check_processes, open_cluster
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.runs import check_interrupt, interrupts_held
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import registry
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.policy.computed import StoredPolicies, mixture, sharpened
from shuttle_marl.training.league.config import MOST_WORKERS, POOL, LeagueTrainingConfig
from shuttle_marl.training.league.population import TABLES, TOLERANCE, Best, Frozen, LeagueState, Member, Payoffs, TurnResult
from shuttle_marl.training.league.schedule import Schedule
from shuttle_marl.training.league.turns import NETWORK, Workers, prune_states, turn_file
from shuttle_marl.training.run import AGENT, PACKAGES, game_of

MAIN: Final = "main.safetensors"
_EVALUATION: Final = ("exploitability", "temperature", "exploitability_as_trained", "rally_win", "match_win", "against")
_ENOUGH: Final = 0.5  # a main exploiter succeeds if it reaches this fraction of the gain of the exact best response
_BEATEN: Final = 0.7  # a league exploiter succeeds at this mean probability of winning a match (Vinyals et al., Nature 2019)
_SHARPER: Final = 0.1  # second softmax temperature at which a main agent is evaluated, to remove the effect of the entropy bonus


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueTraining:
    """A finished league."""

    folder: Path
    figures: dict[str, Any]  # content of `results.json`
    policy: TabulatedPolicy


def train_league(config: LeagueTrainingConfig, console: Console | None = None) -> LeagueTraining:
    """Train a league, or resume its training, and write its run folder.

    Args:
        console: shows progress; None: silent.

    Raises:
        PolicyError: a policy of the pool does not exist or is not a distribution over the legal strokes; nothing was written.
        GameError: the model does not exist; nothing was written.
        RunError: the run folder cannot be used, or the game changed after the run was started.
        TrainingError: learning diverged, or a file of the run is damaged; the last round is intact.
        ClusterError: processes or the cluster cannot be used (nothing was written), or lost turns repeatedly.
        KeyboardInterrupt: Ctrl-C; the message says what is saved.
    """
    check_processes(1 if config.ray is not None else config.workers)
    begun = time.monotonic()
    game = resolve_game(config.game, config.profile)
    config = dataclasses.replace(config, meta_solver=config.meta_solver or ("linear" if game.hides else "nash"))
    names = config.pool or tuple(name for name in POOL if name in registry.names(game)) or ("random",)
    given = dict(zip(names, registry.tabulated(names, game), strict=True))
    fixed, console = config.fixed(), console or Console(quiet=True)
    with contextlib.nullcontext() if config.ray is None else open_cluster(config.ray, PACKAGES) as cluster:
        if cluster is not None:
            config = dataclasses.replace(config, workers=min(cluster.slots, MOST_WORKERS))
        opened = runs.open_run(config.out, "league-training", fixed, resume=config.resume, overwrite=config.overwrite)
        with interrupts_held(), opened as run, run.resumable(lambda: _saved(run.folder)):
            return _League(config, game, given, run, console, begun).go(cluster)


def _saved(folder: Path) -> str:
    state = LeagueState.load(folder)
    return f"round {state.round} is saved" if state.population else "no round is saved yet"


@dataclasses.dataclass(eq=False)
class _League:
    config: LeagueTrainingConfig
    game: Game
    given: dict[str, TabulatedPolicy]
    run: runs.Run
    console: Console
    begun: float

    def __post_init__(self) -> None:
        config, self.folder = self.config, self.run.folder
        self.run.begin(PACKAGES, same={"game": game_of(config.game, self.game)}, seed=config.seed)
        self.tables, self.metrics = StoredPolicies(self.folder / TABLES, self.game), runs.Journal(self.folder / runs.METRICS)
        self.state = LeagueState.load(self.folder)
        self.metrics.keep(self.state.metrics)
        if self.state.population:
            self._say(f"{self.folder}: continues after round {self.state.round}")
        else:
            for name, policy in self.given.items():
                self._join(Frozen(name=name, role="given", round=0, hash=self.tables.save(policy)))
        self.payoffs = Payoffs(self.tables, self.state.cells)
        self.schedule = Schedule(config, self.state, self.payoffs)
        self.begun -= self.state.seconds

    def go(self, cluster: Cluster | None) -> LeagueTraining:
        with Workers(self.config.workers, self.game, cluster) as workers:
            while not self.state.exhausted and self.state.round < self.config.n_rounds:
                check_interrupt()
                with self.console.status(f"round {self.state.round + 1}"):
                    self._oracle_round() if self.config.exact_oracle else self._learning_round(workers)
        return self._finish()

    def _say(self, text: str) -> None:
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _elapsed(self) -> float:
        return time.monotonic() - self.begun

    def _oracle_round(self) -> None:
        number = self.state.round + 1
        answer = self._measure_mixture(number)
        response = Frozen(name=f"oracle@{number}", role="best-response", round=number, hash=self.tables.save(answer.policy))
        # The linear average counts repeated best responses (fictitious play); other meta-strategies do not change.
        joined = self._join(response, again=self.config.meta_solver == "linear")
        self._commit(exhausted=not joined)

    def _learning_round(self, workers: Workers) -> None:
        state, number = self.state, self.state.round + 1
        results = workers.take(self.folder, self.config, self.schedule.turns(number))
        for result in results:
            member = state.members.setdefault(result.member, Member())
            member.turns += 1
            member.strokes += result.strokes
            member.hash = result.hash
        if self.config.variant == "psro":
            self._join(Frozen(name=f"oracle@{number}", role="oracle", round=number, hash=results[0].hash))
            self._measure_mixture(number)
        else:
            self._join_mains([each for each in results if each.member.startswith("main-agent")], number)
            self._join_exploiters([each for each in results if not each.member.startswith("main-agent")], number)
        self._commit()
        prune_states(self.folder, before=number)

    def _join_mains(self, results: list[TurnResult], number: int) -> None:
        for result in results:
            policy = self.tables.read(result.hash)
            answer = exact.best_response(policy, tolerance=TOLERANCE)
            name = f"{result.member}@{number}"
            self._join(Frozen(name=name, role="main", round=number, hash=result.hash))
            sharper = sharpened(policy, _SHARPER)
            forms = [(policy, answer, 1.0), (sharper, exact.best_response(sharper, tolerance=TOLERANCE), _SHARPER)]
            self._measure(name, forms)
            if self.config.variant != "plain":
                response = self.tables.save(answer.policy)
                self._join(Frozen(name=f"best-response:{name}", role="best-response", round=number, hash=response))

    def _join_exploiters(self, results: list[TurnResult], number: int) -> None:
        """Freeze exploiters that succeeded or ran out of patience, and reset them to new weights."""
        mains = [member.hash for name, member in self.state.members.items() if name.startswith("main-agent")]
        for result in results:
            member = self.state.members[result.member]
            role = result.member.rpartition("-")[0]
            if member.turns >= self.config.patience or self._succeeded(role, result, mains):
                self._join(Frozen(name=f"{result.member}@{number}", role=role, round=number, hash=result.hash))
                member.turns, member.hash = 0, ""

    def _succeeded(self, role: str, result: TurnResult, mains: list[str]) -> bool:
        if role == "main-exploiter":
            odds = self.payoffs.odds(result.hash, mains)
            best = self.state.best
            return best is not None and max(each.value for each in odds) > _ENOUGH * best.exploitability
        recent = [each.hash for each in self.state.population[-self.config.max_opponents :]]
        return float(self.payoffs.match_wins(result.hash, recent).mean()) >= _BEATEN

    def _measure_mixture(self, number: int) -> exact.Response:
        """Evaluate the meta-strategy of the population as the main agent; returns the best response to it."""
        strategy = self.schedule.meta_strategy()
        support = np.flatnonzero(strategy)
        mixed = mixture([self.tables.read(self.state.population[i].hash) for i in support], strategy[support])
        answer = exact.best_response(mixed, tolerance=TOLERANCE)
        self._measure(f"mixture@{number}", [(mixed, answer, 1.0)])
        return answer

    def _join(self, policy: Frozen, *, again: bool = False) -> bool:
        """Add a policy, unless its table is in the population (``again``: also then); returns whether it was added."""
        if not again and any(each.hash == policy.hash for each in self.state.population):
            return False
        self.state.population.append(policy)
        return True

    def _measure(self, name: str, forms: list[tuple[TabulatedPolicy, exact.Response, float]]) -> None:
        """Evaluate a main agent in its least exploitable form, of policies with best response and temperature, the first at 1."""
        state = self.state
        gains = [max(0.0, answer.value.odds().value) for _, answer, _ in forms]
        policy, _, temperature = forms[int(np.argmin(gains))]
        exploitability, first = min(gains), state.population[0]
        table = self.tables.save(policy)
        (odds,) = self.payoffs.odds(table, [first.hash])
        line = {
            "round": state.round + 1,
            "policy": name,
            "seconds": round(self._elapsed(), 2),
            "strokes": sum(member.strokes for member in state.members.values()),
            "exploitability": exploitability,
            "temperature": temperature,
            "exploitability_as_trained": gains[0],
            "against": first.name,
            "rally_win": odds.rally,
            "match_win": odds.match(),
            "policies": len(state.population),
        }
        self.metrics.append([line])
        state.metrics += 1
        if state.best is None or exploitability < state.best.exploitability:
            state.best = Best(name=name, hash=table, exploitability=exploitability, temperature=temperature)
        self._say(
            f"round {line['round']}, {line['seconds']:.0f} s: exploitability {exploitability:z.4f} ({name}), "
            f"{odds.match():.1%} of matches won against {first.name}, {len(state.population)} policies"
        )

    def _commit(self, *, exhausted: bool = False) -> None:
        state = self.state
        state.round += 1
        state.exhausted = exhausted
        retained = {each.hash for each in state.population} | {member.hash for member in state.members.values()}
        retained |= set() if state.best is None else {state.best.hash}
        state.cells = self.payoffs.as_json(retained)
        state.seconds = round(self._elapsed(), 2)
        state.save(self.folder)
        # The previous state needed its tables until it was replaced.
        self.tables.prune(retained)

    def _finish(self) -> LeagueTraining:
        state = self.state
        assert state.best is not None  # of the first round
        curve = self.metrics.read()
        policy = self.tables.read(state.best.hash)
        policy.save(self.folder / MAIN, {"policy": state.best.name})
        member, _, number = state.best.name.rpartition("@")
        network = turn_file(self.folder, member, int(number), NETWORK)
        figures = {
            "variant": self.config.variant,
            "seed": self.config.seed,
            "main_agent": state.best.name,
            "exploitability": state.best.exploitability,
            "temperature": state.best.temperature,
            "error_bound": TOLERANCE,
            "last_exploitability": curve[-1]["exploitability"],
            "rounds": state.round,
            "exhausted": state.exhausted,
            "seconds": state.seconds,
            "strokes": sum(each.strokes for each in state.members.values()),
            "policies": [dataclasses.asdict(each) for each in state.population],
            "payoffs_solved": len(state.cells),
            "curve": curve,
        }
        if network.exists():
            line = next(line for line in curve if line["policy"] == state.best.name)
            evaluation = {name: line[name] for name in _EVALUATION}
            card = {"algorithm": self.config.algorithm, "config": self.config.fixed(), "evaluation": evaluation}
            save_agent(self.folder / AGENT, self.game, network.read_bytes(), card)
        replace_file(self.folder / runs.RESULTS, (json.dumps(figures, indent=1) + "\n").encode())
        self.run.finish(seconds=state.seconds)
        return LeagueTraining(folder=self.folder, figures=figures, policy=policy)

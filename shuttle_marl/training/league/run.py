"""A league from its settings to its run folder: rounds of turns, each frozen, measured exactly and saved before the next."""

import contextlib
import dataclasses
import json
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from shuttle_marl import exact, runs
from shuttle_marl.cluster import Cluster, open_cluster
from shuttle_marl.extras import install_hint
from shuttle_marl.files import replace_file
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy import registry
from shuttle_marl.policy.agents import save_agent
from shuttle_marl.training.league.config import MOST_WORKERS, POOL, LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.mixtures import sharpened
from shuttle_marl.training.league.picture import draw
from shuttle_marl.training.league.population import TOLERANCE, Frozen, Payoffs, Tables
from shuttle_marl.training.league.psro import respond
from shuttle_marl.training.league.schedule import LEAST_SECONDS, Schedule
from shuttle_marl.training.league.state import Best, LeagueState, Member
from shuttle_marl.training.league.turns import Taken, forget, network_path
from shuttle_marl.training.league.workers import Workers
from shuttle_marl.training.metrics import Metrics

METRICS: Final = "metrics.jsonl"
RESULTS: Final = "results.json"
PICTURE: Final = "exploitability.png"
MAIN: Final = "main.safetensors"
"""Table of the least exploitable main agent in the folder of a run."""
AGENT: Final = "agent"
"""Folder of its network, where it is one, before it is made sharper."""
_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")
_ENOUGH: Final = 0.5
"""An exploiter that gains so much of what the exact best response gains has done its work."""
_BEATEN: Final = 0.7
"""The same of a league exploiter that wins so many of its matches on average (Vinyals et al., Nature 2019)."""
_SHARPER: Final = 0.1
"""Temperature at which a main agent is measured too: without what a bonus for entropy lets it play."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueTraining:
    """A finished league.

    Attributes:
        folder: the run folder.
        figures: as in ``results.json``.
        policy: the least exploitable main agent.
    """

    folder: Path
    figures: dict[str, Any]
    policy: TabulatedPolicy


def train_league(config: LeagueTrainingConfig, console: Console | None = None) -> LeagueTraining:
    """Train a league, or continue to train it, and write its run folder.

    Args:
        config: what to train.
        console: shows progress; None shows nothing.

    Raises:
        PolicyError: a policy of the pool cannot be found or is no distribution over the legal strokes; nothing was written.
        GameError: the model cannot be found; nothing was written.
        RunError: the run folder cannot be used.
        TrainingError: learning diverged, or a file of the run is damaged; the last round is whole.
        ClusterError: the cluster cannot be used (nothing was written), or loses turns again and again.
    """
    begun = time.monotonic()
    game = resolve_game(config.game, config.profile)
    names = config.pool or tuple(name for name in POOL if name in registry.names(game)) or ("random",)
    given = {name: tabulate(registry.resolve(name, game), game, name) for name in names}
    with contextlib.ExitStack() as stack:
        cluster = None
        if config.ray is not None:
            cluster = stack.enter_context(open_cluster(config.ray, _PACKAGES))
            config = dataclasses.replace(config, workers=min(cluster.slots, MOST_WORKERS))
        opened = runs.open_run(config.out, "league-training", config.fixed(), resume=config.resume, overwrite=config.overwrite)
        folder = stack.enter_context(opened)
        return _League(config, game, given, folder, console or Console(quiet=True), begun).go(cluster)


class _League:
    def __init__(
        self,
        config: LeagueTrainingConfig,
        game: Game,
        given: dict[str, TabulatedPolicy],
        folder: Path,
        console: Console,
        begun: float,
    ) -> None:
        self.config, self.game, self.folder, self.console = config, game, folder, console
        self.tables, self.metrics = Tables(folder, game), Metrics(folder / METRICS)
        saved = LeagueState.load(folder, game.hash)
        self.metrics.cut(None if saved is None else saved.metrics)
        self.state = saved or LeagueState(game=game.hash)
        if saved is None:
            for name, policy in given.items():
                self._join(Frozen(name=name, role="given", round=0, hash=self.tables.keep(policy)))
        else:
            console.print(f"{folder}: continues after round {saved.round}", highlight=False, markup=False)
        self.payoffs = Payoffs(self.tables, self.state.cells)
        self.schedule = Schedule(config, self.state, self.payoffs)
        self.begun = begun - self.state.seconds
        self.longest = 0.0
        """Seconds of the longest round of this process."""

    def go(self, cluster: Cluster | None) -> LeagueTraining:
        about = {
            "status": "running",
            "seed": self.config.seed,
            **runs.describe(_PACKAGES),
            "game": {"model": self.config.game, "hash": self.game.hash, "catalogue": self.game.catalogue.version},
        }
        runs.write_json(self.folder / runs.MANIFEST, about)
        with Workers(self.config.workers, self.game, cluster) as workers:
            while not self._over():
                started = time.monotonic()
                before = self.state.round
                with self.console.status(f"round {before + 1}"):
                    self._oracle_round() if self.config.exact_oracle else self._learning_round(workers)
                self.longest = max(self.longest, time.monotonic() - started)
        return self._finish(about)

    def _elapsed(self) -> float:
        return time.monotonic() - self.begun

    def _over(self) -> bool:
        config, state = self.config, self.state
        if state.converged:
            return True
        if config.seconds is None:
            assert config.n_rounds is not None
            return state.round >= config.n_rounds
        if not state.round:
            return False
        # No round is begun that would end late; turns are cut to the time that is left.
        return self._elapsed() + (self.longest if config.exact_oracle else state.overhead + LEAST_SECONDS) > config.seconds

    # One round of psro with exact best responses

    def _oracle_round(self) -> None:
        strategy = self.schedule.meta_strategy()
        support = np.flatnonzero(strategy)
        population = self.state.population
        mixture, answer = respond([self.tables.read(population[i].hash) for i in support], strategy[support])
        number = self.state.round + 1
        self._measure(f"mixture@{number}", [(mixture, answer, 1.0)])
        found = Frozen(name=f"oracle@{number}", role="best-response", round=number, hash=self.tables.keep(answer.policy))
        # A mean of all best responses counts one that comes again (fictitious play); in other strategies it changes nothing.
        joined = self._join(found, again=self.config.meta == "uniform")
        self._commit(converged=not joined)

    # One round of learners

    def _learning_round(self, workers: Workers) -> None:
        state, number = self.state, self.state.round + 1
        began = self._elapsed()
        turns = self.schedule.turns(number, began)
        taken = workers.take(self.folder, self.config, turns)
        for done in taken:
            member = state.members.setdefault(done.member, Member())
            member.turns += 1
            member.strokes += done.strokes
            member.hash = done.hash
        if self.config.way == "psro":
            self._join_oracle(taken[0], number)
        else:
            self._join_mains([done for done in taken if done.member.startswith("main-agent")], number)
            self._join_exploiters([done for done in taken if not done.member.startswith("main-agent")], number)
        state.overhead = round(max(0.0, self._elapsed() - began - taken[0].seconds * self.schedule.load), 2)
        self._commit()
        forget(self.folder, before=number)

    def _join_mains(self, taken: list[Taken], number: int) -> None:
        for done in taken:
            policy = self.tables.read(done.hash)
            answer = exact.best_response(policy, tolerance=TOLERANCE)
            name = f"{done.member}@{number}"
            self._join(Frozen(name=name, role="main", round=number, hash=done.hash))
            sharper = sharpened(policy, _SHARPER)
            forms = [(policy, answer, 1.0), (sharper, exact.best_response(sharper, tolerance=TOLERANCE), _SHARPER)]
            self._measure(name, forms)
            if self.config.way != "plain":
                response = self.tables.keep(answer.policy)
                self._join(Frozen(name=f"best-response:{name}", role="best-response", round=number, hash=response))

    def _join_exploiters(self, taken: list[Taken], number: int) -> None:
        """Freeze the exploiters that have done their work or tried for long; they begin again with new weights."""
        mains = [member.hash for name, member in self.state.members.items() if name.startswith("main-agent")]
        for done in taken:
            member = self.state.members[done.member]
            role = done.member.rpartition("-")[0]
            if member.turns >= self.config.patience or self._succeeded(role, done, mains):
                self._join(Frozen(name=f"{done.member}@{number}", role=role, round=number, hash=done.hash))
                member.turns, member.hash = 0, ""

    def _succeeded(self, role: str, done: Taken, mains: list[str]) -> bool:
        if role == "main-exploiter":
            odds = self.payoffs.odds(done.hash, mains)
            best = self.state.best
            return best is not None and max(each.value for each in odds) > _ENOUGH * best.exploitability
        recent = [each.hash for each in self.state.population[-self.config.opponents :]]
        return float(self.payoffs.match_wins(done.hash, recent).mean()) >= _BEATEN

    def _join_oracle(self, done: Taken, number: int) -> None:
        """Measure the meta-strategy with the new policy in it, as the main agent."""
        self._join(Frozen(name=f"oracle@{number}", role="oracle", round=number, hash=done.hash))
        strategy = self.schedule.meta_strategy()
        support = np.flatnonzero(strategy)
        population = self.state.population
        mixture, answer = respond([self.tables.read(population[i].hash) for i in support], strategy[support])
        self._measure(f"mixture@{number}", [(mixture, answer, 1.0)])

    # What every round ends with

    def _join(self, policy: Frozen, *, again: bool = False) -> bool:
        """Add a policy, unless the same table is there and may not be there twice; returns whether it was added."""
        if not again and any(each.hash == policy.hash for each in self.state.population):
            return False
        self.state.population.append(policy)
        return True

    def _measure(self, name: str, forms: list[tuple[TabulatedPolicy, exact.Response, float]]) -> None:
        """Write down the figures of a main agent in its least exploitable form.

        Args:
            name: of the policy.
            forms: the policy as it was trained and at other temperatures, each with its best response and its temperature.
        """
        state = self.state
        gains = [max(0.0, answer.value.odds().value) for _, answer, _ in forms]
        policy, _, temperature = forms[int(np.argmin(gains))]
        exploitability, first = min(gains), state.population[0]
        kept = self.tables.keep(policy)
        (odds,) = self.payoffs.odds(kept, [first.hash])
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
        self.metrics.append(line)
        if state.best is None or exploitability < state.best.exploitability:
            state.best = Best(name=name, hash=kept, exploitability=exploitability, temperature=temperature)
        self.console.print(
            f"round {line['round']}, {line['seconds']:.0f} s: exploitability {exploitability:.4f} ({name}), "
            f"{odds.match():.1%} of matches won against {first.name}, {len(state.population)} policies",
            highlight=False,
            markup=False,
        )

    def _commit(self, *, converged: bool = False) -> None:
        state = self.state
        state.round += 1
        state.converged = converged
        kept = {each.hash for each in state.population} | {member.hash for member in state.members.values()}
        kept |= set() if state.best is None else {state.best.hash}
        state.cells = self.payoffs.as_json(kept)
        state.seconds = round(self._elapsed(), 2)
        state.metrics = self.metrics.mark()
        state.save(self.folder)
        # Only now: what the state before named had to be there until it was replaced.
        self.tables.forget(kept)

    def _finish(self, about: dict[str, Any]) -> LeagueTraining:
        state = self.state
        if state.best is None:
            raise LeagueTrainingError(f"{self.folder}: no round is over; train again with a longer --budget and --overwrite")
        curve = [json.loads(line) for line in (self.folder / METRICS).read_text(encoding="utf-8").splitlines()]
        policy = self.tables.read(state.best.hash)
        policy.save(self.folder / MAIN, {"policy": state.best.name})
        member, _, number = state.best.name.rpartition("@")
        network = network_path(self.folder, member, int(number))
        figures = {
            "way": self.config.way,
            "seed": self.config.seed,
            "main_agent": state.best.name,
            "exploitability": state.best.exploitability,
            "temperature": state.best.temperature,
            "error_bound": TOLERANCE,
            "last_exploitability": curve[-1]["exploitability"],
            "rounds": state.round,
            "converged": state.converged,
            "seconds": state.seconds,
            "strokes": sum(each.strokes for each in state.members.values()),
            "policies": [dataclasses.asdict(each) for each in state.population],
            "payoffs_solved": len(state.cells),
            "curve": curve,
        }
        if network.exists():
            card = {"algorithm": self.config.algorithm, "config": self.config.fixed(), "evaluation": _of(curve, state.best.name)}
            save_agent(self.folder / AGENT, self.game, network.read_bytes(), card)
        try:
            draw(curve, self.folder / PICTURE)
        except ModuleNotFoundError:
            self.console.print(f"no picture of the curve: matplotlib is not installed; {install_hint('plot')}", markup=False)
        replace_file(self.folder / RESULTS, (json.dumps(figures, indent=1) + "\n").encode())
        runs.write_json(self.folder / runs.MANIFEST, {**about, "status": "finished", "seconds": state.seconds})
        return LeagueTraining(folder=self.folder, figures=figures, policy=policy)


def _of(curve: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """The figures of a main agent in the curve."""
    line = next(line for line in curve if line["policy"] == name)
    kept = ("exploitability", "temperature", "exploitability_as_trained", "rally_win", "match_win", "against")
    return {key: line[key] for key in kept}

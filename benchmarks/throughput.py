"""Strokes per second of all environments, from one rally to 65,536 in parallel, compared with those of other libraries.

    python -m benchmarks.throughput [--quick] [--json] [--only WHAT ...]

Every name is measured in a fresh process, so that its peak memory is separate; environments without batches share a process and
alternate. Seconds are CPU seconds of the process for one thread, so that other programs hardly affect them, and wall-clock
seconds for several threads. The fastest turn is reported, because other load can only slow a turn down, and the median as well.

``--json`` prints a list of ``{"what", "batch", "threads", "strokes_per_s", ...}``, with the game with recovery at the end:
``recovery_ratio`` is the median ratio to the game without, which alternates with it; ``load`` is the load average at the start of
a measurement.

For ``vector``, ``match_vector`` and ``gymnasium``, the learner's stroke and the reply count as one stroke; in environments of
other libraries, an action counts.

A case is a factory that takes the batch size and the number of threads, and returns a function that plays for some time and
returns the number of strokes. Libraries are imported in the factory, so that their memory is measured separately.
"""
# ruff: noqa: PLC0415  see above

import functools
import importlib
import multiprocessing
import os
import random
import resource
import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Final

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from docs.tools.results import Json, machine, show, this_machine
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.tables import Game

Row = dict[str, Any]

Play = Callable[[], int]
Maker = Callable[[int, int], Play]

_AT_ONCE: Final = 16_384  # approximate number of strokes per call


def _steps(batch: int) -> int:
    return max(1, _AT_ONCE // batch)


def kernel(batch: int, threads: int, game: Game | None = None) -> Play:
    """The kernel plays random legal strokes in all rows, without observations."""
    from shuttle_marl.kernel import RallyBatch

    rows = RallyBatch(game or default_game(), batch, threads=threads)
    steps = 4 * _steps(batch)

    def play() -> int:
        rows.run(steps)
        return steps * batch

    return play


def kernel_observed(batch: int, threads: int, game: Game | None = None) -> Play:
    """Random legal strokes as actions, each checked, with observations and masks."""
    from shuttle_marl.kernel import RallyBatch

    rows = RallyBatch(game or default_game(), batch, threads=threads)
    seen, steps, hides = rows.new_observations(), _steps(batch), rows.game.hides

    def play() -> int:
        for _ in range(steps):
            stroke, position = rows.random_actions()
            rows.step(stroke, position if hides else None, observed=seen)
        return steps * batch

    return play


def tournament(batch: int, threads: int) -> Play:
    """Whole matches between two policies, with all strokes in memory; the batch is the number of matches."""
    from shuttle_marl.game import draws
    from shuttle_marl.game.policy import tabulate
    from shuttle_marl.kernel import Matches, pack, play_matches
    from shuttle_marl.policy.registry import resolve

    game = default_game()
    players = pack([tabulate(resolve(name, game), game) for name in ("bc", "attacking")], game)
    matches = Matches(
        entrant=np.tile(np.array([0, 1], np.int32), (batch, 1)),
        first_server=(np.arange(batch) % 2).astype(np.int8),
        key=draws.stream(0, np.arange(batch)),
    )
    return lambda: len(play_matches(game, matches, players, threads=threads).rallies.stroke)


def torchrl(batch: int, threads: int, game: Game | None = None) -> Play:
    """``RallyEnv`` with TorchRL's loop, resetting in the same call as the step; random legal strokes."""
    from shuttle_marl.env.batched import RallyEnv

    return _rolled_out(RallyEnv(batch, threads=threads, game=game), batch, threads)


def torchrl_stock(batch: int, threads: int) -> Play:
    """The same with TorchRL's step and reset."""
    from torchrl.envs import EnvBase

    from shuttle_marl.env.batched import RallyEnv

    class Stock(RallyEnv):
        step_and_maybe_reset = EnvBase.step_and_maybe_reset

    return _rolled_out(Stock(batch, threads=threads), batch, threads)


def _rolled_out(env: Any, batch: int, threads: int) -> Play:
    import torch

    torch.set_num_threads(threads)
    now, steps = env.reset(), max(1, _steps(batch) // 8)

    def play() -> int:
        nonlocal now
        for _ in range(steps):
            _, now = env.step_and_maybe_reset(env.rand_action(now))
        return steps * batch

    return play


def jax(batch: int, _: int, game: Game | None = None) -> Play:
    """``shuttle_marl.env.jax``, many strokes in one compiled call; random legal strokes, observations and masks.

    With recovery the receiver takes a random feasible position.
    """
    import jax as jax_library
    import jax.numpy as jnp
    from jax import random

    from shuttle_marl.env import jax as rally

    game = game or default_game()
    steps, positions = _steps(batch), jnp.asarray(game.waiting.position)

    def stroke(tables: rally.Tables, now: Any, key: Any) -> tuple[Any, Any]:
        state, seen = now
        base, (one, two, *others) = state % (len(tables.base_pair_start) - 1), random.split(key, 2 + game.hides)
        arguments: tuple[Any, ...] = ()
        if tables.places is not None:
            arguments = (positions[base, rally.draws(others[0], state.shape) * tables.places.choices[base] >> 24],)
        k = random.randint(one, state.shape, 0, tables.base_pair_start[base + 1] - tables.base_pair_start[base])
        chosen = tables.edge_incoming[tables.reply_edge[tables.first_reply[base] + k]]
        arguments = state, chosen, rally.draws(two, state.shape), *arguments
        after = jax_library.vmap(rally.step, (None, *(0 for _ in arguments)))(tables, *arguments)
        tokens, mask = jax_library.vmap(rally.observe, (None, 0))(tables, after.state)
        # XLA removes what is not used.
        return (after.state, seen + tokens.sum(axis=1) + mask.sum(axis=1)), None

    @jax_library.jit
    def played(tables: rally.Tables, now: Any, key: Any) -> Any:
        keys = random.split(key, steps + 1)
        now, _ = jax_library.lax.scan(lambda n, k: stroke(tables, n, k), now, keys[1:])
        return now, keys[0]

    tables = rally.Tables.of(game)
    now, key = (jnp.tile(rally.init(), batch), jnp.zeros(batch, jnp.int32)), random.key(0)

    def play() -> int:
        nonlocal now, key
        now, key = played(tables, now, key)
        now[0].block_until_ready()
        return steps * batch

    return play


def vector(batch: int, threads: int, game: Game | None = None) -> Play:
    """``RallyVectorEnv`` against ``bc``, random legal actions; a step, which holds one action of the learner, counts once."""
    from shuttle_marl.env.vector import RallyVectorEnv

    env = RallyVectorEnv(batch, opponent="bc", threads=threads, game=game)
    return _stepped(env, batch, env.random_actions)


def match_vector(batch: int, threads: int) -> Play:
    """``MatchVectorEnv`` against ``bc``, random legal strokes; a stroke and what ``bc`` plays until the next one count once."""
    from shuttle_marl.env.vector import MatchVectorEnv

    env = MatchVectorEnv(batch, opponent="bc", threads=threads)
    return _stepped(env, batch, env.random_actions)


def _stepped(env: Any, batch: int, actions: Callable[[], Any]) -> Play:
    steps = max(1, _steps(batch) // 8)
    env.reset(seed=0)

    def play() -> int:
        for _ in range(steps):
            env.step(actions())
        return steps * batch

    return play


def cartpole_vector(batch: int, threads: int) -> Play:  # noqa: ARG001
    """Gymnasium's own vector environment of ``CartPole-v1``, random actions."""
    import gymnasium

    env = gymnasium.make_vec("CartPole-v1", num_envs=batch, vectorization_mode="vector_entry_point")
    rng = np.random.default_rng(0)
    return _stepped(env, batch, lambda: rng.integers(0, 2, batch))


def gymnasium_env(batch: int, threads: int) -> Play:  # noqa: ARG001
    """``shuttle_marl/Rally-v0`` against ``bc``, random legal strokes; a stroke and the reply to it count once."""
    import gymnasium

    env = gymnasium.make("shuttle_marl/Rally-v0", opponent="bc")
    rng, (seen, _) = random.Random(0), env.reset(seed=0)

    def play() -> int:
        nonlocal seen
        for _ in range(100):
            seen, _, over, _, _ = env.step(rng.choice(np.flatnonzero(seen["action_mask"]).tolist()))
            if over:
                seen, _ = env.reset()
        return 100

    return play


def _steps_of_an_episode(env: Any, rng: random.Random) -> int:
    """Play an episode with random legal actions; returns how many that were."""
    steps = 0
    env.reset()
    for _ in env.agent_iter():
        observation, _, terminated, truncated, _ = env.last()
        if terminated or truncated:
            env.step(None)
        else:
            env.step(rng.choice(np.flatnonzero(observation["action_mask"]).tolist()))
            steps += 1
    return steps


def classic(name: str, batch: int, threads: int) -> Play:  # noqa: ARG001
    """PettingZoo's loop with random legal actions in one of its games, one episode a call."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the modules will move to a registry
        env, rng = importlib.import_module(f"pettingzoo.classic.{name}").env(), random.Random(0)
    env.reset(seed=0)
    return lambda: _steps_of_an_episode(env, rng)


def aec(batch: int, threads: int, game: Game | None = None) -> Play:  # noqa: ARG001
    """The same loop in ``rally_v0``; strokes alone count."""
    from shuttle_marl import rally_v0

    env, rng = rally_v0.env(game=game), random.Random(0)
    env.reset(seed=0)

    def play() -> int:
        _steps_of_an_episode(env, rng)
        return len(env.unwrapped.strokes)

    return play


_MANY: Final = (kernel, kernel_observed, torchrl, torchrl_stock, jax, vector, match_vector, tournament, cartpole_vector)
BATCHED: Final[dict[str, Maker]] = {case.__name__: case for case in _MANY}
"""Cases that play many rallies in parallel; each is measured in a separate process."""
SINGLE: Final[dict[str, Maker]] = {
    "gymnasium": gymnasium_env,
    "aec": aec,
    **{name: functools.partial(classic, name) for name in ("connect_four_v3", "tictactoe_v3")},
}
"""Environments without batches, which alternate in one process."""
RECOVERY: Final[dict[str, Callable[[int, int, Game], Play]]] = {
    case.__name__: case for case in (kernel, kernel_observed, torchrl, vector, aec, jax)
}
"""Cases that are also measured in the game with recovery, in alternation with the game without."""
ONE_THREAD: Final = ("cartpole_vector", "jax", *SINGLE)  # cases that are not told the number of their threads
BATCHES: Final = (1, 64, 1024, 8192, 65_536)
THREADS: Final = (1, 2)
_HIDDEN_BATCH: Final = 8192
_NAMES: Final = (*BATCHED, *SINGLE)


def speeds(plays: Sequence[Play], seconds: float, turns: int, threads: int) -> list[list[float]]:
    """Strokes per second of each turn; the environments alternate.

    A turn is over when its time is, but not amid a call; where all turns would need more than four times their time on the
    clock, there are fewer.
    """
    clock = time.process_time if threads == 1 else time.perf_counter
    for play in plays:
        play()  # compiles, if need be
    found: list[list[float]] = [[] for _ in plays]
    last_start = time.perf_counter() + 4 * seconds * turns * len(plays)
    while len(found[0]) < turns and (not found[0] or time.perf_counter() < last_start):
        for play, speeds_of_play in zip(plays, found, strict=True):
            strokes, begun = 0, clock()
            while True:
                strokes += play()
                taken = clock() - begun
                if taken >= seconds:
                    break
            speeds_of_play.append(strokes / taken)
    return found


def peak_mb() -> float:
    """Peak memory of this process [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def row(what: str, batch: int, threads: int, found: Sequence[float], **more: Any) -> Row:
    """A measurement, as a row of the results."""
    return {
        "what": what,
        "batch": batch,
        "threads": threads,
        "strokes_per_s": max(found),
        "median_per_s": statistics.median(found),
        "peak_mb": round(peak_mb(), 1),
        **more,
    }


def measure_batched(what: str, batches: Sequence[int], threads: Sequence[int], seconds: float, turns: int) -> list[Row]:
    """All batch sizes of one case in increasing order, so that the peak memory is that of the batch."""
    found = []
    for batch in sorted(batches):
        for count in threads if what not in ONE_THREAD else (1,):
            (measured,) = speeds([BATCHED[what](batch, count)], seconds, turns, count)
            found.append(row(what, batch, count, measured))
    return found


def measure_single(names: Sequence[str], seconds: float, turns: int) -> list[Row]:
    """Environments without batches, which alternate in one process."""
    found = speeds([SINGLE[name](1, 1) for name in names], seconds, turns, threads=1)
    return [row(name, 1, 1, measured) for name, measured in zip(names, found, strict=True)]


def measure_recovery(what: str, seconds: float, turns: int) -> list[Row]:
    """A case in the game with recovery, and how fast it is beside the game without."""
    games, batch = (default_game(), load_game("default:recovery")), _HIDDEN_BATCH if what in BATCHED else 1
    without, found = speeds([RECOVERY[what](batch, 1, game) for game in games], seconds, turns, threads=1)
    ratio = statistics.median(one / other for one, other in zip(found, without, strict=True))
    return [row(what, batch, 1, found, recovery_ratio=ratio)]


def measure(only: Sequence[str], batches: Sequence[int], threads: Sequence[int], seconds: float, turns: int) -> list[Row]:
    """Run the requested cases, each in a fresh process."""
    jobs: list[tuple[Callable[..., list[Row]], tuple[Any, ...]]] = [
        (measure_batched, (name, batches, threads, seconds, turns)) for name in BATCHED if name in only
    ]
    singles = [name for name in SINGLE if name in only]
    if singles:
        jobs.append((measure_single, (singles, seconds, turns)))
    jobs += [(measure_recovery, (name, seconds, turns)) for name in RECOVERY if name in only]
    rows: list[Row] = []
    for job, arguments in track(jobs, "measuring", console=Console(stderr=True)):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
            load = round(os.getloadavg()[0], 1)
            rows += [{**measured, "load": load} for measured in fresh.submit(job, *arguments).result()]
    where = machine(this_machine()).removesuffix(".")
    return [{**measured, "machine": where} for measured in rows]


def main(
    *,
    quick: bool = False,
    only: tuple[str, ...] = _NAMES,
    batches: tuple[int, ...] = BATCHES,
    threads: tuple[int, ...] = THREADS,
    seconds: float = 0.02,
    turns: int = 50,
    as_json: Json = False,
) -> None:
    """Measure and print.

    Args:
        quick: ten turns of 0.01 seconds each.
        only: what to measure; all of it by default.
        batches: rallies, matches or environments at once.
        threads: threads that share a batch.
        seconds: length of a turn.
        turns: turns of each measurement.
        as_json: print JSON instead of tables.
    """
    unknown = sorted(set(only) - set(_NAMES))
    if unknown:
        raise ShuttleError(f"no such measurement: {', '.join(unknown)}; there are {', '.join(_NAMES)}")
    if quick:
        seconds, turns = 0.01, 10
    rows = measure(only, batches, threads, seconds, turns)
    show(rows, "throughput", *(["throughput_recovery"] if any("recovery_ratio" in row for row in rows) else []), as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)

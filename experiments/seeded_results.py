"""Seeded results of one checkout, through the public names of ``shuttle_marl`` alone; :mod:`experiments.same_results` runs it.

    PYTHONPATH=CHECKOUT python -P experiments/seeded_results.py AREA OUT

Prints a JSON object of digests by item. The file is run, not imported, so that both checkouts compute the same.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

import shuttle_marl as sm

GAMES: Final = ("default", "default:recovery")
SAMPLE: Final = "datasets/sample/strokes.parquet"
TRAINING: Final[dict[str, Any]] = {
    **{"strokes": 6000, "batch": 512, "width": 16, "threads": 1, "seed": 4, "checkpoint_every": 2, "evaluate_every": 1000}
}


def digest(value: Any) -> str:
    """Hash of bytes, or of what represents another value, all digits of its numbers."""
    content = value if isinstance(value, bytes) else repr(value).encode()
    return hashlib.sha256(content).hexdigest()


def game(out: Path) -> dict[str, Any]:  # noqa: ARG001
    """Hashes of games, of tables of policies, and of the files of the models."""
    found: dict[str, Any] = {}
    for name in GAMES:
        loaded = sm.load_game(name)
        found[name] = loaded.hash
        for policy in ("bc", "attacking", "safe", "random", "ppo", "sac", "bc:viktor-axelsen"):
            found[f"{name} {policy}"] = sm.tabulate(sm.resolve(policy, loaded), loaded).hash
    found["pair"] = [seat.hash for seat in sm.pair_game("viktor-axelsen", "kento-momota").seats]
    files = Path(sm.__file__).parent.rglob("*.safetensors")
    return found | {"/".join(file.parts[-3:]): file.read_bytes() for file in files}


def play(out: Path) -> dict[str, Any]:  # noqa: ARG001
    """Random legal strokes in each kind of environment."""
    import gymnasium  # noqa: PLC0415
    import torch  # noqa: PLC0415

    found: dict[str, Any] = {}
    for name, module in (("rally", sm.rally_v0), ("match", sm.match_v0)):
        for model in GAMES:
            env, rng, seen = module.env(game=model, render_mode="ansi"), np.random.default_rng(1), []
            for seed in range(8 if name == "rally" else 1):
                env.reset(seed=seed)
                for agent in env.agent_iter():
                    state, reward, *ends, info = env.last()
                    action = None if any(ends) else int(rng.choice(np.flatnonzero(state["action_mask"])))
                    seen.append([agent, *state.values(), reward, *ends, sorted(info.items())])
                    env.step(action)
            found |= {f"{name} {model}": seen, f"{name} {model} as text": env.render()}
    vector = gymnasium.make_vec("shuttle_marl:shuttle_marl/Rally-v0", num_envs=16)
    state, rng, seen = vector.reset(seed=2)[0], np.random.default_rng(2), []
    for _ in range(50):
        actions = np.array([rng.choice(np.flatnonzero(row)) for row in state["action_mask"]])
        state, *others = vector.step(actions)
        seen.append([*state.values(), *others[:3]])
    torch.manual_seed(3)
    steps = sm.RallyEnv(16, seed=3).rollout(40).items(True, True)
    return found | {"vector": seen, "torchrl": sorted((str(key), value.numpy().tolist()) for key, value in steps)}


def exact(out: Path) -> dict[str, Any]:  # noqa: ARG001
    """Values, perfect play, best responses and odds of both games."""
    found: dict[str, Any] = {}
    for name in GAMES:
        loaded = sm.load_game(name)
        solution = sm.solve(loaded)
        bc, *others = policies = [sm.tabulate(sm.resolve(policy, loaded), loaded) for policy in ("bc", "ppo", "attacking")]
        found |= {
            f"{name} value": solution.value_at_serve,
            f"{name} perfect play": [policy.hash for policy in solution.policy],
            f"{name} best response": sm.best_response(bc).policy.hash,
            f"{name} exploitability": [sm.nash_conv(policy).exploitability for policy in policies],
            f"{name} odds": [sm.evaluate(other, bc).odds() for other in others],
            f"{name} crossplay": sm.crossplay(policies).serving,
        }
    return found


def training(out: Path) -> dict[str, Any]:
    """Runs of each algorithm, whole, and stopped after a checkpoint and resumed; their files are the results."""
    configs = {
        "ppo": sm.PPOConfig(**TRAINING),
        "a2c": sm.A2CConfig(**TRAINING),
        "sac": sm.SACConfig(**TRAINING, warm_up=600, minibatch=64),
        "self-play": sm.PPOConfig(**TRAINING, opponent=("self",)),
        "recovery": sm.PPOConfig(**TRAINING, opponent=("self",), game="default:recovery"),
    }
    stopping: list[Path] = []

    def stop(event: str, arguments: tuple[Any, ...]) -> None:  # Ctrl-C when the first checkpoint comes to its place
        if event == "os.rename" and stopping and Path(os.fsdecode(arguments[1])).is_relative_to(stopping[0]):
            stopping.clear()
            os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell that starts this in the background has disabled
    sys.addaudithook(stop)
    for name, config in configs.items():
        sm.train(dataclasses.replace(config, out=out / name))
        stopped = dataclasses.replace(config, out=out / f"{name}-resumed")
        stopping.append(out / f"{name}-resumed" / "checkpoints")
        with contextlib.suppress(KeyboardInterrupt):
            sm.train(stopped)
            raise SystemExit(f"{name} ended before it was stopped")
        sm.train(dataclasses.replace(stopped, resume=True))
    return {}


def reports(out: Path) -> dict[str, Any]:  # noqa: ARG001
    """Figures and pages of a match and of an opponent, in three languages."""
    made = {"match": sm.report(SAMPLE, "axelsen chou"), "scouting": sm.scouting_report("an-se-young", "chen-yufei", data=SAMPLE)}
    found: dict[str, Any] = {f"{name} {key}": figure for name, report in made.items() for key, figure in report.figures.items()}
    return found | {f"{name} page in {x}": report.html(x) for name, report in made.items() for x in ("en", "zh", "id")}


def pictures(out: Path) -> dict[str, Any]:  # noqa: ARG001
    """Images of a rally."""
    found: dict[str, Any] = {}
    for name, module in (("rally", sm.rally_v0), ("match", sm.match_v0)):
        env, rng = module.env(render_mode="rgb_array"), np.random.default_rng(5)
        env.reset(seed=5)
        for number in range(4):
            found[f"{name} {number}"] = env.render().tobytes()
            if not any(env.last()[2:4]):
                env.step(int(rng.choice(np.flatnonzero(env.last()[0]["action_mask"]))))
    return found


def logs(out: Path) -> dict[str, Any]:
    """Columns of all rally logs in a folder."""
    found: dict[str, Any] = {}
    for path in sorted(out.rglob("rallies*.mcap")):
        with sm.RallyLog(path) as log:
            for rows, table in (("rally", log.rally_table()), ("stroke", log.stroke_table())):
                for name in table.column_names:
                    found[f"{path.relative_to(out).as_posix()}: {rows} {name}"] = table[name].to_pylist()
    return found


AREAS: Final[dict[str, Callable[[Path], dict[str, Any]]]] = {
    found.__name__: found for found in (game, play, exact, training, reports, pictures, logs)
}

if __name__ == "__main__":
    np.set_printoptions(threshold=sys.maxsize, floatmode="unique")
    results = AREAS[sys.argv[1]](Path(sys.argv[2]))
    sys.stdout.write(json.dumps({name: digest(value) for name, value in results.items()}))

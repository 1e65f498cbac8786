"""Parts of learners on tensors of a few numbers: minibatches, checks, checkpoints, opponents and references of self-play."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn

from shuttle_marl.base import runs
from shuttle_marl.game.tabulated import from_pair_probabilities
from shuttle_marl.training import Evaluation, PPOConfig, TrainingError, self_play
from shuttle_marl.training import run as training_run
from shuttle_marl.training.learner import (
    Learner,
    Mean,
    RallyCollector,
    check_finite,
    minibatches,
    normalised,
    set_learning_rate,
    weighted_sums,
    with_prefix,
)
from shuttle_marl.training.networks import MIN_LOG, DistinctStrokes, DivergedError, LegalStrokes, imitate, make_actor, tabulated
from shuttle_marl.training.run import Checkpoint, _Run, last_checkpoint, resumable, save_checkpoint
from shuttle_marl.training.self_play import ReferencePolicy, SelfPlayOpponents
from tests.exact.exact_games import tiring_game


def strokes() -> TensorDict:
    """Five states with 2, 1, 0, 2 and 1 rows of strokes."""
    return TensorDict(
        {
            "observation": torch.arange(5)[:, None],
            "action_mask": torch.ones(5, 3, dtype=torch.bool),
            "value_target": torch.arange(5.0)[:, None],
            "visits": torch.tensor([4, 1, 0, 3, 2]),
            "start": torch.tensor([0, 2, 3, 3, 5, 6]),
            "row": torch.tensor([0, 0, 1, 3, 3, 4]),
            "action": torch.arange(6),
            "action_log_prob": torch.arange(6.0),
            "advantage": torch.tensor([1.0, -1, 2, 4, -2, 6])[:, None],
            "strokes": torch.tensor(10),
            "deviation": torch.tensor(0.5, dtype=torch.float64),
        },
        [],
    )


def test_weights_are_shares_of_strokes_and_advantages_are_normalised() -> None:
    found = normalised(strokes())
    assert torch.allclose(found["weight"], torch.tensor([0.4, 0.1, 0, 0.3, 0.2]))
    # Divided by 10 strokes and by a deviation of a half.
    assert torch.allclose(found["advantage"][:, 0], torch.tensor([0.2, -0.2, 0.4, 0.8, -0.4, 1.2]))
    alike = normalised(strokes().update({"deviation": torch.tensor(0.0)}))
    assert torch.allclose(alike["advantage"][:, 0], 1e5 * torch.tensor([1.0, -1, 2, 4, -2, 6]))


@pytest.mark.parametrize(
    ("count", "states", "rows"),
    [(2, [[0, 1], [2, 3, 4]], [[0, 0, 1], [1, 1, 2]]), (9, [[0], [1], [2], [3], [4]], [[0, 0], [0], [], [0, 0], [0]]),
     (1, [[0, 1, 2, 3, 4]], [[0, 0, 1, 3, 3, 4]]), (0, [[0, 1, 2, 3, 4]], [[0, 0, 1, 3, 3, 4]])],
)  # fmt: skip
def test_minibatches_hold_the_rows_of_their_states(count: int, states: list[list[int]], rows: list[list[int]]) -> None:
    data = normalised(strokes())
    parts = list(minibatches(data, count))
    assert [part["observation"][:, 0].tolist() for part in parts] == states
    assert [part["row"].tolist() for part in parts] == rows
    assert [part["value_target"][:, 0].tolist() for part in parts] == states
    assert all(len(part["action_mask"]) == len(part["weight"]) for part in parts)
    for name in ("action", "action_log_prob"):
        assert torch.cat([part[name] for part in parts]).tolist() == list(range(6))
    for name in ("weight", "advantage"):
        whole = torch.cat([part[name] for part in parts]).ravel()
        assert torch.allclose(whole, len(parts) * data[name].ravel())


def test_terms_are_summed_with_the_weights_of_their_states() -> None:
    terms: dict[str, torch.Tensor] = {"loss_critic": torch.tensor([[1.0], [2]]), "loss_entropy": torch.tensor([3.0, 4])}
    terms |= {"loss_objective": torch.tensor([1.0, 5, 7]), "kept": torch.tensor(9.0)}
    found = weighted_sums(TensorDict(cast(Any, terms), []), torch.tensor([0.25, 0.75]))
    numbers = {name: found[name].item() for name in ("loss_critic", "loss_entropy", "loss_objective", "kept")}
    assert numbers == {"loss_critic": 1.75, "loss_entropy": 3.75, "loss_objective": 13.0, "kept": 9.0}


def test_means_over_gradient_steps() -> None:
    mean = Mean("a", "b")
    mean.add(TensorDict({"a": torch.tensor([1.0, 3]), "b": torch.tensor(1.0), "c": torch.tensor(math.nan)}, []))
    mean.add(TensorDict({"a": torch.tensor(5.0), "b": torch.tensor(2.0)}, []))
    assert mean.values() == {"a": 3.5, "b": 1.5}
    for wrong in (math.nan, math.inf, -math.inf):
        with pytest.raises(DivergedError, match=f"b became {wrong}"):
            mean.add(TensorDict({"a": torch.tensor(1.0), "b": torch.tensor(wrong)}, []))


def test_only_finite_floats_are_finite() -> None:
    check_finite([torch.tensor([1.0, -1e30]), torch.tensor([1, 2]), torch.tensor([True])])
    check_finite([])
    for wrong in (math.nan, math.inf):
        with pytest.raises(DivergedError, match="a weight is not finite"):
            check_finite([torch.zeros(3), torch.tensor([0.0, wrong])])


def test_learning_rates_fall_to_a_fiftieth() -> None:
    optimizer = torch.optim.Adam([nn.Parameter(torch.zeros(1))], lr=0.5)
    for remaining, rate in ((1.0, 8.0), (0.5, 4.0), (0.02, 0.16), (0.01, 0.16), (0.0, 0.16)):
        set_learning_rate(optimizer, 8.0, remaining)
        assert optimizer.param_groups[0]["lr"] == pytest.approx(rate)


def test_names_with_a_prefix() -> None:
    one, two = torch.zeros(1), torch.ones(1)
    assert with_prefix("a", {"a.b": one, "ab.c": two, "b.a.b": two, "a.a.c": two}) == {"b": one, "a.c": two}


class Small(Learner):
    """A layer of two weights and their optimiser."""

    def __init__(self) -> None:
        layer = nn.Linear(2, 1, bias=False)
        layer.register_buffer("attributes", torch.tensor([1, 2]))
        self.optimizer = torch.optim.Adam(layer.parameters(), lr=0.1)
        self.layer, self.modules, self.optimizers = layer, {"layer": layer}, {"optimizer": self.optimizer}

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return observation, observation

    def update(self, data: Any, remaining: float) -> dict[str, float]:
        loss = self.layer(torch.ones(1, 2)).sum()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {}


def test_a_learner_is_restored_with_its_moments_and_with_its_own_attributes() -> None:
    learner, other = Small(), Small()
    learner.update(None, 1.0)
    state = learner.state_dict()
    assert set(state) == {
        "layer.weight",
        "layer.attributes",
        *(f"optimizer.0.{name}" for name in ("step", "exp_avg", "exp_avg_sq")),
    }
    other.load_state_dict({**state, "layer.attributes": torch.tensor([99, 99])})
    assert other.layer.get_buffer("attributes").tolist() == [1, 2]
    for each in (learner, other):
        each.update(None, 1.0)
    assert torch.equal(learner.layer.weight, other.layer.weight)
    assert learner.state_dict()["optimizer.0.step"] == 2


WRONG: list[dict[str, torch.Tensor]] = [
    {"layer.weight": torch.zeros(2)},
    {"layer.weight": torch.zeros(1, 2, dtype=torch.float64)},
    {"layer.attributes": torch.tensor([1, 2, 3])},
    {"optimizer.0.exp_avg": torch.zeros(2)},
    {"optimizer.0.exp_avg_sq": torch.zeros(1, 3)},
    {"optimizer.0.step": torch.zeros(1)},
]


@pytest.mark.parametrize("wrong", WRONG, ids=[next(iter(each)) for each in WRONG])
def test_a_learner_takes_no_state_of_another_shape(wrong: dict[str, torch.Tensor]) -> None:
    learner = Small()
    learner.update(None, 1.0)
    state = learner.state_dict()
    learner.load_state_dict(state)
    with pytest.raises(ValueError, match=rf"^{'.'.join(next(iter(wrong)).split('.')[:2])}: "):
        learner.load_state_dict({**state, **wrong})
    with pytest.raises(KeyError):
        learner.load_state_dict({name: part for name, part in state.items() if name != next(iter(wrong))})


def test_illegal_strokes_have_the_smallest_probability_and_rows_belong_to_states() -> None:
    logits = torch.tensor([[0.0, math.log(3), 50], [1, 1, 1]])
    mask = torch.tensor([[True, True, False], [False, True, False]])
    plain = LegalStrokes(logits, mask=mask)
    assert torch.allclose(plain.probs, torch.tensor([[0.25, 0.75, 0], [0, 1, 0]]))
    assert plain.logits.min() == MIN_LOG
    assert plain.logits[0, 0].item() == pytest.approx(math.log(0.25))
    assert plain.deterministic_sample.tolist() == [1, 1]
    assert plain.entropy()[0].item() == pytest.approx(0.25 * math.log(4) + 0.75 * math.log(4 / 3))
    assert plain.entropy()[1].item() == pytest.approx(0)
    learned = LegalStrokes(logits.clone().requires_grad_(), mask=mask)
    assert learned.logits.min() < MIN_LOG, "gradients need the true ones"
    distinct = DistinctStrokes(logits, mask=mask, row=torch.tensor([1, 0, 0]))
    found = distinct.log_prob(torch.tensor([1, 0, 1]))
    assert torch.allclose(found, torch.tensor([0.0, math.log(0.25), math.log(0.75)]), atol=1e-6)
    each = distinct.log_prob(torch.tensor([[0, 1], [1, 1]]))
    assert torch.allclose(each, torch.tensor([[math.log(0.25), 0], [math.log(0.75), 0]]), atol=1e-6)


class Sampler:
    """Notes what self-play asks of it."""

    def __init__(self) -> None:
        self.assigned: list[list[int]] = []
        self.opponents: dict[int, object] = {}
        self.restarts: list[tuple[np.ndarray, float]] = []

    def assign(self, order: np.ndarray) -> None:
        self.assigned.append(order.tolist())

    def replace_opponent(self, slot: int, policy: object) -> None:
        self.opponents[slot] = policy

    def restart(self, states: np.ndarray, fraction: float) -> None:
        self.restarts.append((states, fraction))


@pytest.fixture
def weights(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers stand for weights, in their order, and text for policies."""
    number: list[int] = []

    def weights_of(actor: object, temperature: float) -> dict[str, np.ndarray]:
        number.append(len(number))
        return {"w": np.array([number[-1], temperature])}

    network = SimpleNamespace(of_tensors=lambda found, _: SimpleNamespace(table=lambda game: f"{game} {found['w'].tolist()}"))
    monkeypatch.setattr(self_play, "weights_of", weights_of)
    monkeypatch.setattr(self_play, "PolicyNetwork", network)
    return number


def opponents(sampler: Sampler, **flags: Any) -> SelfPlayOpponents:
    learner: Any = SimpleNamespace(actor="actor")
    return SelfPlayOpponents(PPOConfig(opponent=("self",), **flags), cast(Any, "game"), learner, cast(Any, sampler))


def test_a_pool_of_earlier_policies_is_filled_in_turn(weights: list[int]) -> None:
    sampler = Sampler()
    own = opponents(sampler, variant="pool", pool_size=2, update_interval=3, fraction=0.2, eval_temperature=0.5)
    for iteration in range(8):
        own.update(iteration)
    assert weights == [0, 1, 2], "before iterations 0, 3 and 6"
    assert sampler.opponents == {0: "game [2.0, 0.5]", 1: "game [1.0, 0.5]"}
    one, two, again = sampler.assigned
    # One rally in five is against the pool, whose policies take turns.
    assert (one[:10], len(one)) == ([-1, -1, -1, -1, 0] * 2, 100)
    assert (two[:10], len(two)) == ([-1, -1, -1, -1, 0, -1, -1, -1, -1, 1], 200)
    assert again == two
    state = own.state_dict()
    assert {name: part.tolist() for name, part in state.items()} == {"pool.0.w": [2.0, 0.5], "pool.1.w": [1.0, 0.5]}
    sampler_2 = Sampler()
    resumed = opponents(sampler_2, variant="pool", pool_size=2, update_interval=3)
    resumed.load_state_dict({**state, "loss.w": torch.zeros(1)})
    assert sampler_2.opponents == sampler.opponents
    assert (sampler_2.assigned[-1], len(sampler_2.assigned)) == (two, 2)


@pytest.mark.parametrize(("fraction", "rallies"), [(0.0, 0), (0.37, 37), (1.0, 100)])
def test_each_opponent_has_the_same_number_of_rallies(fraction: float, rallies: int) -> None:
    sampler = Sampler()
    opponents(sampler, variant="pool", fraction=fraction)._assign(3)
    assert [sampler.assigned[0].count(k) for k in (-1, 0, 1, 2)] == [300 - 3 * rallies, rallies, rallies, rallies]


@pytest.fixture
def responses(monkeypatch: pytest.MonkeyPatch) -> list[tuple[object, ...]]:
    asked: list[tuple[object, ...]] = []
    visits = SimpleNamespace(states=(np.array([0.0, 1, 0, 3]), np.array([9.0, 0, 0, 0])))

    def best_response(policy: str, tolerance: float) -> SimpleNamespace:
        asked.append((policy, tolerance))
        return SimpleNamespace(policy=f"response {len(asked)}")

    monkeypatch.setattr(self_play, "tabulated", lambda actor, game, temperature: f"{actor} at {temperature}")
    monkeypatch.setattr("shuttle_marl.exact.best_response", best_response)
    monkeypatch.setattr("shuttle_marl.exact.visits", lambda *_, tolerance: visits)
    return asked


def test_best_responses_are_solved_at_the_interval_and_after_a_seed(responses: list[tuple[object, ...]]) -> None:
    sampler = Sampler()
    own = opponents(sampler, variant="best-response", update_interval=3, fraction=0.5)
    for iteration in (1, 2, 3, 4):
        own.update(iteration)
    own.set_seed(5)
    own.update(5)
    assert responses == [("actor at 0.1", 1e-4)] * 3, "the first, the third, and that after the seed"
    assert sampler.opponents == {0: "response 3"}
    assert sampler.assigned == [[-1, 0] * 50] * 3
    assert own.state_dict() == {}


def test_rallies_restart_where_a_best_response_leads(responses: list[tuple[object, ...]]) -> None:
    sampler = Sampler()
    own = opponents(sampler, variant="restarts", update_interval=3, fraction=0.25)
    for seed, iteration in ((7, 0), (7, 3), (8, 3), (7, 0)):
        own.set_seed(seed)
        own.update(iteration)
    for states, fraction in sampler.restarts:
        assert (len(states), fraction) == (1 << 15, 0.25)
        assert np.bincount(states) / len(states) == pytest.approx([0, 0.25, 0, 0.75], abs=0.01)
    drawn = [states.tolist() for states, _ in sampler.restarts]
    assert drawn[0] == drawn[3]
    assert len({str(each[:99]) for each in drawn}) == 3
    assert sampler.opponents == {}
    assert len(responses) == 4


def reference(variant: Any, rate: float = 0.25) -> tuple[ReferencePolicy, nn.Linear]:
    network = nn.Linear(1, 2, bias=False)
    with torch.no_grad():
        network.weight.copy_(torch.tensor([[0.0], [math.log(3)]]))
    config = PPOConfig(opponent=("self",), variant=variant, magnet_rate=rate, update_interval=4)
    return ReferencePolicy(config, network), network


@pytest.mark.parametrize(
    ("variant", "rate", "expected"),
    [
        *((variant, 0.25, [2.0, 3.5, 4.625, 5.46875]) for variant in ("magnet", "emagnet")),
        ("emagnet", 0.0, [0, 0, 0, 0]),
        ("emagnet", 1.0, [8, 8, 8, 8]),
        ("nash", 0.25, [0, 0, 0, 8]),
    ],
)
def test_magnets_average_parameters_and_nash_copies_them(variant: str, rate: float, expected: list[float]) -> None:
    own, network = reference(variant, rate)
    with torch.no_grad():
        network.weight += 8.0
    moved = []
    for iteration in (1, 2, 3, 4):
        own.update(iteration)
        moved.append(next(own.network.parameters())[0].item())
    assert moved == pytest.approx(expected)
    assert not any(weight.requires_grad for weight in own.network.parameters())


def test_the_divergence_is_that_of_the_policy_from_the_reference() -> None:
    own, network = reference("magnet")
    data = TensorDict({"observation": torch.ones(2, 1), "action_mask": torch.tensor([[True, True], [False, True]])}, [])
    assert own.divergence(data).tolist() == pytest.approx([0, 0])
    with torch.no_grad():
        network.weight.zero_()
    # Of (1/2, 1/2) from (1/4, 3/4), and of the only legal stroke from itself.
    expected = 0.5 * math.log(2) + 0.5 * math.log(2 / 3)
    assert own.divergence(data).tolist() == pytest.approx([expected, 0], abs=1e-6)


def test_the_latest_two_checkpoints_are_kept(tmp_path: Path) -> None:
    assert last_checkpoint(tmp_path) is None
    for iteration in (3, 20, 100):
        save_checkpoint(tmp_path, iteration, {"x": torch.tensor([float(iteration)])}, {"iteration": iteration})
    (tmp_path / "checkpoints" / "00000999").mkdir()  # incomplete
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["00000020", "00000100", "00000999"]
    about, state = last_checkpoint(tmp_path) or ({}, {})
    assert (about["iteration"], state["x"].tolist()) == (100, [100.0])
    save_checkpoint(tmp_path, 100, {"x": torch.tensor([5.0])}, {"iteration": 100})
    assert (last_checkpoint(tmp_path) or ({}, {}))[1]["x"].tolist() == [5.0]
    (tmp_path / "file").touch()
    with pytest.raises(runs.RunError, match=r"00000001: cannot be written .* continue with --resume"):
        save_checkpoint(tmp_path / "file", 1, {}, {})


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_error_is_an_interrupt_if_there_was_one(interrupted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_run, "was_interrupted", lambda: interrupted)
    raised: tuple[tuple[type[BaseException], type[BaseException]], ...] = (
        (KeyboardInterrupt, KeyboardInterrupt),
        (ValueError, KeyboardInterrupt if interrupted else ValueError),
    )
    for kind, seen in raised:
        with pytest.raises(seen) as caught, resumable(Path("run"), lambda: "round 3 is saved"):
            raise kind("as it was")
        said = "interrupted; round 3 is saved; the same with --resume --out run continues"
        assert str(caught.value) == ("as it was" if seen is ValueError else said)


def a_run(**fields: Any) -> Any:
    """A run with some of its parts."""
    config = PPOConfig(strokes=1000, batch=100, growth=0.0, evaluate_every=4, budget=fields.pop("budget", None))
    at = Checkpoint(game="", seconds=fields.pop("seconds", 0.0), best=fields.pop("best", None))
    trainer = SimpleNamespace(iteration=fields.pop("iteration", 0), strokes=500)
    return SimpleNamespace(
        **{"config": config, "at": at, "trainer": trainer, "limit": config.seconds, "evaluating": 0.0, **fields}
    )


@pytest.mark.parametrize(
    ("budget", "iteration", "seconds", "fraction"),
    [(None, 0, 9.0, 0.0), (None, 3, 0.0, 0.3), ("10s", 3, 5.0, 0.5), ("10s", 7, 5.0, 0.7), ("10s", 3, 99.0, 1.0)],
)
def test_the_fraction_of_a_run_is_that_of_its_iterations_or_of_its_time(
    budget: str | None, iteration: int, seconds: float, fraction: float
) -> None:
    run = a_run(budget=budget, iteration=iteration, seconds=seconds)
    run.config = PPOConfig(strokes=1000, batch=100, growth=0.0, budget=budget)
    assert _Run._fraction(run) == pytest.approx(fraction)


@pytest.mark.parametrize(
    ("iteration", "budget", "seconds", "evaluated", "stopped"),
    [
        (4, None, 50.0, True, False),
        (5, None, 50.0, False, False),
        (10, None, 50.0, True, False),
        (5, "60s", 57.0, False, False),  # and 3 s for an evaluation
        (5, "60s", 57.5, True, True),
    ],
)
def test_a_run_is_evaluated_at_the_interval_and_at_its_end(
    iteration: int, budget: str | None, seconds: float, evaluated: bool, stopped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([1000.0 + seconds, 1000.0 + seconds + 2])
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    shown: list[Any] = []
    task = SimpleNamespace(id=1, total=10)
    bar: Any = SimpleNamespace(tasks=(task,), update=lambda *_, **about: shown.append(about))
    figures = Evaluation(rally_win=0.5, match_win=0.25, normalised_score=None, exploitability=None)
    run = a_run(budget=budget, iteration=iteration, begun=1000.0, evaluating=3.0, _fraction=lambda: 0.5)
    run._evaluate = lambda losses, board: figures
    _Run._after(run, {}, cast(Any, None), bar)
    assert (run.at.seconds, run.at.stopped, run.evaluating) == (seconds, stopped, 2.0 if evaluated else 3.0)
    assert [about.get("completed") for about in shown] == [5, None][: 1 + evaluated]
    if evaluated:
        assert "wins 50.0% of rallies, 25.0% of matches" in shown[1]["status"]


def evaluated(found: Evaluation, best: float | None, own: bool, **targets: float) -> tuple[Any, list[str], list[Any]]:
    """A run after an evaluation, the agents that it saved, and the scalars on its board."""
    saved: list[str] = []
    lines: list[Any] = []
    scalars: list[Any] = []
    run = a_run(best=best, seconds=2.0, iteration=4, folder=Path())
    run.config = PPOConfig(opponent=("self",) if own else ("bc",), **cast(Any, targets))
    run._diverging, run._evaluated = pytest.MonkeyPatch.context, lambda: ("policy", found)
    run._save_agent = lambda name, _: saved.append(name)
    run.metrics = SimpleNamespace(append=lines.extend)
    board: Any = SimpleNamespace(add_scalar=lambda *about: scalars.append(about))
    assert _Run._evaluate(run, {"loss": 0.5}, board) is found
    assert lines == [{"iteration": 4, "strokes": 500, "seconds": 2.0, **dataclasses.asdict(found), "loss": 0.5}]
    assert run.at.metrics == 1
    return run.at, saved, scalars


def test_the_best_agent_is_saved_and_targets_stop_a_run() -> None:
    found = Evaluation(rally_win=0.5, match_win=0.75, normalised_score=0.25, exploitability=0.125)
    at, saved, scalars = evaluated(found, None, own=False)
    assert (at.best, at.stopped, saved) == (0.5, False, ["best"])
    assert {name: value for name, value, _ in scalars} == {
        **{"rally_win": 0.5, "match_win": 0.75, "normalised_score": 0.25, "exploitability": 0.125, "loss": 0.5},
        "strokes_per_second": 250.0,
    }
    assert {step for *_, step in scalars} == {500}
    for best, own, better in ((0.5, False, False), (0.49, False, True), (-0.13, True, True), (-0.125, True, False)):
        at, saved, _ = evaluated(found, best, own=own)
        assert saved == ["best"] * better
        assert at.best == ((-0.125 if own else 0.5) if better else best)
    for targets, stopped in (
        ({"target": 0.75}, True), ({"target": 0.76}, False), ({"target_score": 0.25}, True), ({"target_score": 0.26}, False),
    ):  # fmt: skip
        assert evaluated(found, None, own=False, **targets)[0].stopped == stopped
    unknown = dataclasses.replace(found, normalised_score=None)
    at, _, scalars = evaluated(unknown, None, own=False, target_score=0.1)
    assert not at.stopped
    assert "normalised_score" not in {name for name, *_ in scalars}


def test_seeds_of_segments_differ_and_use_31_bits() -> None:
    run: Any = SimpleNamespace(config=PPOConfig(seed=4))
    run._seed = lambda *numbers: _Run._seed(run, *numbers)
    seeds = [_Run._segment_seed(run, segment) for segment in range(200)]
    assert len(set(seeds)) == 200
    assert 1 << 30 < max(seeds) < 1 << 31
    assert 1 << 62 < max(run._seed(1, segment) for segment in range(9)) < 1 << 63


def test_a_run_that_diverges_says_what_is_kept() -> None:
    for iteration, says in ((0, "no weights were saved yet"), (7, "the weights of iteration 7 are kept")):
        run = a_run(folder=Path("run"), iteration=9)
        run.at.iteration = iteration
        with pytest.raises(TrainingError, match=f"run: learning diverged in iteration 9: too far; {says}"), _Run._diverging(run):
            raise DivergedError("too far")


def test_an_actor_imitates_a_policy_in_every_state_however_rare() -> None:
    game = tiring_game()
    preferred = 4.0 ** -(game.pair_stroke % 3)
    policy = from_pair_probabilities(game, preferred / np.bincount(game.pair_state, preferred)[game.pair_state])
    weight = np.where(game.playable, 1e-6, 0.0)
    weight[np.flatnonzero(game.playable)[-1]] = 1.0
    gaps, tables = [], []
    for steps in (1, 60):
        torch.manual_seed(0)
        actor = make_actor(game, width=8, hidden=0)
        gaps.append(imitate(actor, policy, weight, torch.Generator().manual_seed(5), steps=steps))
        tables.append(tabulated(actor, game).pair_probabilities())
    start, end = (np.abs(table - policy.pair_probabilities()).max() for table in tables)
    assert start > 0.25
    assert end < 0.2
    assert 0 < 5 * gaps[1] < gaps[0]


def test_a_collector_counts_what_remains_and_checks_the_network() -> None:
    own: Any = SimpleNamespace(
        _config=SimpleNamespace(iterations=5), _observer=SimpleNamespace(observations=lambda states: states)
    )
    for iteration, remaining in ((0, 5), (4, 1), (5, 0), (7, 0)):
        own.iteration = iteration
        assert RallyCollector.__len__(own) == remaining
    for logit, value in ((1.0, 2.0), (math.nan, 2.0), (1.0, math.inf), (-math.inf, 2.0)):
        own._predict = lambda _, found=(logit, value): (torch.tensor([[found[0], 0.5]]), torch.tensor([found[1]]))
        if math.isfinite(logit + value):
            logits, values = RallyCollector._outputs(own, np.zeros(1, np.int32))
            assert (logits.tolist(), values.tolist()) == ([[1.0, 0.5]], [2.0])
        else:
            with pytest.raises(DivergedError, match="an output of the network is not finite"):
                RallyCollector._outputs(own, np.zeros(1, np.int32))

"""Tables of policies: made of others, in files, and of agents in folders."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import agents
from shuttle_marl.policy.computed import StoredPolicies, deterministic, mixture, policy_file, sharpened
from tests.exact.exact_games import THREE_STROKES, hand_made, random_game, random_policy, with_probabilities
from tests.exact.test_hidden_positions_solved import waiting, with_recovery

SMALL = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))
WAITING = with_recovery(random_game(4), 4)
FIRST, SECOND = (random_policy(SMALL, seed) for seed in (0, 1))


def biggest(policy: TabulatedPolicy, share: np.ndarray) -> np.ndarray:
    """For each pair whether its share is the largest of its state."""
    most = np.zeros(policy.game.n_states)
    np.maximum.at(most, policy.game.pair_state, share)
    return np.asarray(share == most[policy.game.pair_state])


def test_a_mixture_has_the_mean_shares() -> None:
    found = mixture([FIRST, SECOND], [0.75, 0.25])
    expected = 0.75 * FIRST.pair_probabilities() + 0.25 * SECOND.pair_probabilities()
    np.testing.assert_allclose(found.pair_probabilities(), expected, atol=2e-5)
    assert found.waits is None


def test_parts_of_probability_zero_are_not_in_a_mixture() -> None:
    assert mixture([FIRST, SECOND], [0.0, 1.0]) is SECOND
    assert mixture([FIRST, SECOND, FIRST], np.array([0.5, 0.0, 0.5])).hash == FIRST.hash
    with pytest.raises(ValueError, match="shorter"):
        mixture([FIRST, SECOND], [1.0])


@pytest.mark.parametrize("own", [(True, True), (True, False), (False, False)])
def test_a_mixture_has_the_mean_of_positions(own: tuple[bool, bool]) -> None:
    """Who has no positions waits as people do; if all do, the mixture has none either."""
    parts = [waiting(random_policy(WAITING, i), i) for i in range(2)]
    parts = [part if keeps else dataclasses.replace(part, waits=None) for part, keeps in zip(parts, own, strict=True)]
    found = mixture(parts, [0.25, 0.75])
    people = WAITING.people_positions(np.arange(WAITING.n_states))
    shares = [part.position_probabilities() if keeps else people for part, keeps in zip(parts, own, strict=True)]
    assert shares[0] is not None
    assert shares[1] is not None
    np.testing.assert_allclose(found.position_probabilities(), 0.25 * shares[0] + 0.75 * shares[1], atol=2e-5)
    assert (found.waits is None) == (own == (False, False))


@pytest.mark.parametrize(("temperature", "power"), [(0.5, 2.0), (2.0, 0.5), (1.0, 1.0)])
def test_shares_of_a_sharpened_policy_are_powers(temperature: float, power: float) -> None:
    weight = FIRST.pair_probabilities() ** power
    expected = weight / np.bincount(SMALL.pair_state, weight, SMALL.n_states)[SMALL.pair_state]
    np.testing.assert_allclose(sharpened(FIRST, temperature).pair_probabilities(), expected, atol=3e-5)


@pytest.mark.parametrize("game", [SMALL, WAITING], ids=["without recovery", "with recovery"])
def test_a_deterministic_policy_makes_the_likeliest_choices(game: Game) -> None:
    policy = random_policy(game, 5)
    found = deterministic(policy)
    share = found.pair_probabilities()
    assert set(np.unique(share)) <= {0.0, 1.0}
    np.testing.assert_array_equal(share == 1, biggest(policy, policy.pair_probabilities()))
    if game is SMALL:
        assert found.waits is None
        return
    for each in (policy, waiting(policy, 5)):  # waiting as people do, and in another way
        likeliest = each.position_probabilities().argmax(axis=1)
        np.testing.assert_array_equal(deterministic(each).position_probabilities(), np.eye(N_POSITIONS)[likeliest])


def test_stored_policies_are_read_by_their_hash(tmp_path: Path) -> None:
    stored, policy, other = StoredPolicies(tmp_path, SMALL), random_policy(SMALL, 0), random_policy(SMALL, 1)
    assert stored.save(policy) == policy.hash
    assert stored.read(policy.hash).hash == policy.hash
    policy_file(tmp_path, policy.hash).write_bytes(other.packed())
    with pytest.raises(PolicyError, match=f"the table was changed: its hash is {other.hash[:12]}"):
        stored.read(policy.hash)
    assert stored.save(policy) == policy.hash, "what is there is not written again"
    with pytest.raises(PolicyError, match="the table was changed"):
        stored.read(policy.hash)
    with pytest.raises(PolicyError, match=r"the policy cannot be read \(No such file"):
        stored.read(other.hash)
    policy_file(tmp_path, other.hash).write_bytes(b"no table")
    with pytest.raises(PolicyError, match=f"{other.hash}.zst: the policy cannot be read"):
        stored.read(other.hash)


def test_agents_play_the_game_of_their_card(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="no trained agent"):
        agents.load_agent(tmp_path, SMALL)
    agents.save_agent(tmp_path, SMALL, b"no network", {"steps": 3})
    card = agents.read_card(tmp_path)
    assert (card["game"], card["catalogue"], card["steps"]) == (SMALL.hash, SMALL.catalogue.version, 3)
    with pytest.raises(PolicyError, match=r"network\.safetensors: cannot be used"):
        agents.load_agent(tmp_path, SMALL)
    other = with_probabilities(SMALL, 1)
    with pytest.raises(PolicyError, match=f"trained on game {SMALL.hash[:12]}; this is {other.hash[:12]}"):
        agents.load_agent(tmp_path, other)
    with pytest.raises(PolicyError, match=f"trained on game {SMALL.hash[:12]}, whose strokes are not these; this is"):
        agents.load_agent(tmp_path, hand_made())

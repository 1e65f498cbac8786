"""Tables in files and agents in folders."""

from pathlib import Path

import pytest

from shuttle_marl.game.policy import PolicyError
from shuttle_marl.policy import agents
from shuttle_marl.policy.stored import StoredPolicies, policy_file
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy, with_probabilities

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))


def test_stored_policies_are_read_by_their_hash(tmp_path: Path) -> None:
    stored, policy, other = StoredPolicies(tmp_path, GAME), random_policy(GAME, 0), random_policy(GAME, 1)
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
        agents.load_agent(tmp_path, GAME)
    agents.save_agent(tmp_path, GAME, b"no network", {"steps": 3})
    card = agents.read_card(tmp_path)
    assert (card["game"], card["catalogue"], card["steps"]) == (GAME.hash, GAME.catalogue.version, 3)
    with pytest.raises(PolicyError, match=r"network\.safetensors: cannot be used"):
        agents.load_agent(tmp_path, GAME)
    other = with_probabilities(GAME, 1)
    with pytest.raises(PolicyError, match=f"trained on game {GAME.hash[:12]}; this is {other.hash[:12]}"):
        agents.load_agent(tmp_path, other)
    with pytest.raises(PolicyError, match=f"trained on game {GAME.hash[:12]}, whose strokes are not these; this is"):
        agents.load_agent(tmp_path, hand_made())

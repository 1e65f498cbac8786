"""Files of a league that is resumed: turns, states of learners, and the state of the league."""

import dataclasses
from pathlib import Path

import torch

from shuttle_marl.training.checkpoints import write_state
from shuttle_marl.training.league.state import Turn, TurnResult
from shuttle_marl.training.league.turns import completed, prune_states

MEMBER = "main-agent-0"


def result_of(member: str = MEMBER, letter: str = "a", strokes: int = 7, seconds: float = 1.5) -> TurnResult:
    return TurnResult(member=member, hash=letter * 64, strokes=strokes, seconds=seconds, iterations=2)


def test_states_of_earlier_rounds_are_deleted_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "learners"
    folder.mkdir()
    for number in (1, 2, 3, 10):
        for kind in ("state.safetensors", "network.safetensors", "json"):
            (folder / f"league-exploiter-12-{number}.{kind}").touch()
    prune_states(tmp_path, before=3)
    left = {path.name.removeprefix("league-exploiter-12-") for path in folder.iterdir()}
    everywhere = {f"{number}.{kind}" for number in (1, 2, 3, 10) for kind in ("network.safetensors", "json")}
    assert left == everywhere | {"3.state.safetensors", "10.state.safetensors"}


def test_a_turn_is_completed_if_its_files_are_whole_and_its_settings_the_same(tmp_path: Path) -> None:
    turn, result = Turn(member=MEMBER, round=2, strokes=5), result_of()
    assert completed(tmp_path, turn) is None
    (tmp_path / "learners").mkdir()
    state, about = (tmp_path / "learners" / f"{MEMBER}-2.{kind}" for kind in ("state.safetensors", "json"))
    content = {"turn": dataclasses.asdict(turn), "result": dataclasses.asdict(result)}
    write_state(state, about, {"x": torch.zeros(2)}, content)
    assert completed(tmp_path, turn) == result
    assert completed(tmp_path, dataclasses.replace(turn, strokes=6)) is None
    state.unlink()
    assert completed(tmp_path, turn) is None
    state.touch()
    about.write_bytes(about.read_bytes()[:-9])
    assert completed(tmp_path, turn) is None

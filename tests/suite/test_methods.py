"""Methods, tasks, templates and cases by name."""

from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.suite.exploit import Equilibrium, Exploit
from shuttle_marl.suite.method import BASELINES, find
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.results import TASKS, arena_of, find_task
from shuttle_marl.suite.run import new_submission
from shuttle_marl.suite.task import Arena
from tests.reduced import reduced_game, reduced_model

number_seven = 7


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nothing", "no method 'nothing' of exploit-v1; there are: ppo, a2c"),
        ("", "no method '' of exploit-v1"),
        ("mine:", "no method 'mine:' of exploit-v1"),
        ("bc:3", "method 'bc:3': bc takes no argument"),
        (f"{__name__}:number_seven", "is a int; expected a function or a class"),
    ],
)
def test_methods_that_are_none(name: str, says: str) -> None:
    with pytest.raises(SuiteError, match=says):
        find("exploit-v1", name)


@pytest.mark.parametrize(("task", "name"), [(kind, name) for kind, known in BASELINES.items() for name in known])
def test_every_baseline_is_found(task: str, name: str) -> None:
    assert callable(find(f"{task}-v0", name))


@pytest.mark.parametrize(
    ("task", "split", "variant"),
    [("exploit-v1", "test", ":recovery"), ("exploit-entrance-v1", "test", ""), ("equilibrium-v1", "dev", ":women-recovery")],
)
def test_splits_are_played_in_their_games(task: str, split: Any, variant: str) -> None:
    assert arena_of(find_task(task), reduced_model(), split).model == f"{reduced_model()}{variant}"


def test_budgets_are_those_of_the_task() -> None:
    assert {case.budget for case in Exploit().cases(Arena(game=reduced_game()))} == {10**5, 10**6, 10**7}
    assert [case.budget for case in Equilibrium().cases(Arena(game=reduced_game()))] == [10**7, 10**8]
    assert {case.budget for case in Exploit().cases(Arena(game=reduced_game(), budget=10**6))} == {10**6}
    with pytest.raises(SuiteError, match="--budget 5: exploit-v1 has 100000, 1000000, 10000000"):
        Exploit().cases(Arena(game=reduced_game(), budget=5))


def test_names_of_tasks_and_splits() -> None:
    assert find_task("adapt-v1") is TASKS["adapt-v1"]
    with pytest.raises(SuiteError, match=r"no task 'exploit'.*there are: exploit-v1, exploit-entrance-v1"):
        find_task("exploit")


def test_a_submission_is_new_files_and_has_an_author(tmp_path: Path) -> None:
    for author in (" 1", "bob/best"):
        with pytest.raises(SuiteError, match=f"--author '{author}': expected a name with letters, without /"):
            new_submission("exploit-v1", tmp_path, author)
    assert "run exploit-v1 --method my_player:train --quick" in new_submission("exploit-v1", tmp_path / "mine", "alice")
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {"my_player.py", "card.json"}
    for kept in ("my_player.py", "card.json"):
        (tmp_path / kept).mkdir()
        (tmp_path / kept / kept).touch()
        with pytest.raises(SuiteError, match=f"{kept}: already exists; name another folder"):
            new_submission("exploit-v1", tmp_path / kept, "alice")

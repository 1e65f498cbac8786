"""Run folders and policies of strangers: no code runs that the user did not request, and results stay where they belong."""

import json
import shutil
from pathlib import Path

import pytest

from shuttle_marl.base.runs import CONFIG, MANIFEST
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.league import LeagueConfig
from shuttle_marl.policy.registry import resolve
from tests.reduced import reduced_game, reduced_model
from tests.tournaments import play_league


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a tournament; look, do not touch."""
    out = tmp_path_factory.mktemp("played") / "run"
    return play_league(LeagueConfig(pool=("random", "safe"), matches=2, game=reduced_model(), out=out)).folder


@pytest.fixture
def folder(played: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, beside a module that notes that it was imported."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stranger.py").write_text("from pathlib import Path\nPath('ran').touch()\n\ndef policy(states): ...\n")
    return shutil.copytree(played, tmp_path / "run")


def forge(folder: Path, *names: str) -> None:
    config = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps({**config, "pool": [*config["pool"], *names], "grown": [2]}))
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps({**manifest, "status": "running"}))


@pytest.mark.parametrize("name", ["program:touch ran", "stranger:policy", "best-response:stranger:policy", "table:/etc/passwd"])
@pytest.mark.parametrize("flags", [{"pool": ("random", "safe"), "resume": True}, {"pool": ("attacking",), "extend": True}])
def test_names_in_a_folder_run_nothing(name: str, flags: dict[str, object], folder: Path) -> None:
    forge(folder, name)
    with pytest.raises(PolicyError, match=r"not resolved because a file named it.*repeat it in --pool"):
        play_league(LeagueConfig(matches=2, game=reduced_model(), out=folder, **flags))  # type: ignore[arg-type]
    assert not Path("ran").exists()


@pytest.mark.parametrize("grown", [None, [5], [2, 2, 1], [2**70]])
def test_forged_numbers_of_entrants_are_refused(grown: object, folder: Path) -> None:
    forge(folder)
    config = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps({**config, "grown": grown}))
    with pytest.raises(Exception, match=r"config\.json: (cannot be read|grown)"):
        play_league(LeagueConfig(pool=("random", "safe"), matches=2, game=reduced_model(), out=folder, resume=True))


def test_a_policy_that_changes_the_working_directory_moves_no_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    lines = ("import os", "os.chdir('elsewhere')", "def policy(states):", "    os.chdir('/')")
    last = "    return states.mask / states.mask.sum(axis=1, keepdims=True)"
    (tmp_path / "mover.py").write_text("\n".join((*lines, last)))
    run = play_league(LeagueConfig(pool=("mover:policy", "safe"), matches=2, game=reduced_model(), out=Path("run")))
    assert (tmp_path / "run" / MANIFEST).exists()
    assert not any(result.forfeit for result in run.results)
    assert run.folder == Path("run")


def test_saves_of_one_policy_are_equal(tmp_path: Path) -> None:
    game = reduced_game()
    policy = tabulate(resolve("safe", game), game)
    paths = [tmp_path / f"{i}.safetensors" for i in range(5)]
    for path in paths:
        policy.save(path, {"policy": "safe", "made": "here", "b": "c"})
        game.save(path.with_suffix(".game"))
    assert len({path.read_bytes() for path in paths}) == 1
    assert len({path.with_suffix(".game").read_bytes() for path in paths}) == 1
    assert TabulatedPolicy.load(paths[0], game).hash == policy.hash

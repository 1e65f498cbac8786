"""Shared parts of all command lines: exit statuses, messages instead of tracebacks, the console script, and the public names."""

import contextlib
import errno
import importlib
import importlib.metadata
import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

import shuttle_marl
from docs.tools import command_reference
from shuttle_marl.__main__ import main
from shuttle_marl.base.errors import ShuttleError, command
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli, watch
from shuttle_marl.game import default_game
from shuttle_marl.policy import registry

ROOT = Path(__file__).parents[2]


def check_closed_pipe(command: Sequence[str]) -> None:
    """Check that the command ends without a word, with the status of a closed pipe."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        program.stdout.close()
        assert program.stderr.read() == ""
        assert program.wait(60) == 141


def status_of(command: Callable[[], object]) -> int:
    return cli.run(command, prog="tea", description="Serves tea.", argv=[])


def raising(error: BaseException) -> Callable[[], None]:
    def command() -> None:
        """Raise."""
        raise error

    return command


def test_an_error_that_users_can_fix_is_a_message(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(lambda: None) == 0
    assert status_of(raising(KeyboardInterrupt())) == 130
    capsys.readouterr()
    assert status_of(raising(ShuttleError("pot [red] is empty; fill it"))) == 1
    assert capsys.readouterr().err == "error: tea: pot [red] is empty; fill it\n"
    assert status_of(raising(MemoryError("Unable to allocate 298 GiB"))) == 1
    assert "not enough memory (Unable to allocate 298 GiB)" in capsys.readouterr().err
    for defect in (OSError(errno.EIO, "I/O error", "x"), ModuleNotFoundError("m", name="no_such_module")):
        with pytest.raises(type(defect)):
            status_of(raising(defect))


@pytest.mark.parametrize("started", ["-m shuttle_marl.league", "-m shuttle_marl", "script"])
@pytest.mark.parametrize("imported", ["numpy", "tyro"])
def test_an_interrupt_while_a_command_is_imported_is_one_line(started: str, imported: str, tmp_path: Path) -> None:
    script = tmp_path / "shuttle-marl"
    script.write_text("import sys\nfrom shuttle_marl.__main__ import main\nsys.exit(main())\n")
    (tmp_path / "sitecustomize.py").write_text(f"""
import signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent may ignore it

class Interrupting:
    def find_spec(self, name, *_):
        if name == {imported!r}:
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
""")
    arguments = ["--help"] if started.endswith("league") else ["league", "--help"]
    command = [sys.executable, *(started.split() if started.startswith("-m") else [str(script)]), *arguments]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


TALKS = """
import sys
from shuttle_marl.base import extras
from shuttle_marl.commands import cli

def command() -> None:
    for i in range({lines}):
        sys.stdout.write(f"{{i:100}}\\n")
    cli.console().print("end")

sys.exit(cli.run(command, prog="tea", description="Talks.", argv=[]))
"""


def test_the_reader_of_the_output_closes_it_on_the_way() -> None:
    check_closed_pipe([sys.executable, "-u", "-c", TALKS.format(lines=10_000)])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full disk")
def test_the_output_does_not_fit_on_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-c", TALKS.format(lines=1)]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    assert done.stderr == "error: tea: the output cannot be written (No space left on device); free disk space\n"
    assert done.returncode == 1


@pytest.mark.parametrize(("code", "name"), [(errno.ENAMETOOLONG, "x" * 256), (errno.EACCES, "[/bold]"), (errno.EROFS, b"/cdrom")])
def test_a_file_that_cannot_be_used_is_a_message(code: int, name: str | bytes, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(raising(OSError(code, os.strerror(code), name))) == 1
    assert capsys.readouterr().err == (
        f"error: tea: {os.fsdecode(name)} cannot be used ({os.strerror(code)}); name another file or folder\n"
    )


def test_arguments_that_are_no_text(capsys: pytest.CaptureFixture[str]) -> None:
    def serve(cup: str) -> None:
        """Serve."""

    argument = os.fsdecode(b"--cup=\xff")
    assert cli.run(serve, prog="tea", description="Serves tea.", argv=[argument]) == 1
    assert capsys.readouterr().err == "error: tea: argument '--cup=\\udcff': expected text in UTF-8\n"


def test_messages_are_neither_markup_nor_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(raising(ShuttleError("no file in [/data] given :tea: \x1b[2J"))) == 1
    assert capsys.readouterr().err == "error: tea: no file in [/data] given :tea: \\x1b[2J\n"
    cli.console().print("[/data] :smile: [bold]")
    assert capsys.readouterr().out == "[/data] :smile: [bold]\n"


@pytest.mark.parametrize(
    ("library", "extra"), [("torch", "train"), ("torch.nn", "train"), ("pygame", "render"), ("foxglove.messages", "scene")]
)
def test_a_library_of_an_extra_that_is_missing_is_named(
    library: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (library.partition(".")[0], library):
        monkeypatch.setitem(sys.modules, name, None)
    assert status_of(lambda: importlib.import_module(library)) == 1
    message = capsys.readouterr().err
    assert f"needs {library.partition('.')[0]}, which is not installed" in message
    assert f"[{extra}]" in message


@pytest.mark.parametrize(
    ("flags", "says"),
    [(["--date", "2021-01-02"], "give both"), (["--players", "a", "b", "--replay", "a.mcap"], "leave out --players")],
)
def test_what_cannot_be_watched_together(flags: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert watch.main(flags) == 1
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "number"),
    [("2000", 2000), ("60_000", 60_000), ("1e6", 10**6), ("2.5E3", 2500), ("60k", 60_000), ("1.5M", 1_500_000), ("-3", -3)],
)
def test_whole_numbers_are_read_in_every_form(text: str, number: int) -> None:
    got: list[int] = []

    def serve(*, cups: int = 1) -> None:
        got.append(cups)

    assert cli.run(serve, prog="tea", description="", argv=[f"--cups={text}"]) == 0
    assert got == [number]


@pytest.mark.parametrize("text", ["k", "1.5", "1e", "2x", "nan", "inf", "1e999999999", "9" * 5000, "\u0662x"])
def test_other_numbers_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    def serve(*, cups: int = 1) -> None:
        raise AssertionError(cups)

    with pytest.raises(SystemExit) as stop:
        cli.run(serve, prog="tea", description="", argv=[f"--cups={text}"])
    assert stop.value.code == 2
    assert "expected a whole number" in "".join(capsys.readouterr())


def test_errors_of_a_subcommand_point_to_its_own_help(capsys: pytest.CaptureFixture[str]) -> None:
    def serve(*, cups: int = 1) -> None:
        """Serve tea."""

    with pytest.raises(SystemExit):
        cli.run({"serve": serve, "brew": serve}, prog="tea", description="", argv=["serve", "--cups", "x"])
    assert "see tea serve --help" in " ".join("".join(capsys.readouterr()).replace("│", " ").split())


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_what_a_terminal_cannot_show_is_escaped(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "own.csv").write_text(
        "match,rally,player,shot,area,winner\n李,1,Ada,Schläger 李,front-centre,Ada\n", encoding="utf-8"
    )
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    for arguments, status in (([".data", "import", "own.csv", "--json"], 1), (["", "--help"], 0)):
        command = [sys.executable, "-m", f"shuttle_marl{arguments[0]}", *arguments[1:]]
        done = subprocess.run(
            command, env={**environment, "PYTHONPATH": str(ROOT)}, cwd=tmp_path, capture_output=True, check=False
        )
        assert done.returncode == status
        assert b"Traceback" not in done.stderr
        done.stdout.decode(encoding)


SCRIPT = str(Path(sysconfig.get_path("scripts")) / "shuttle-marl")
LAUNCHERS = pytest.mark.parametrize("launcher", [[SCRIPT], [sys.executable, "-m", "shuttle_marl"]], ids=["script", "module"])


def call(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


@LAUNCHERS
def test_help_lists_every_command(launcher: list[str]) -> None:
    done = call(*launcher, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    found = {path.parent.name for path in Path(shuttle_marl.__file__).parent.glob("*/__main__.py")}
    found |= {"analysis", "policies", "report", "scout", "watch"}  # commands that are no package
    assert len(found) > 5
    assert {line.split()[0] for line in done.stdout.splitlines() if line.startswith("  ")} == found
    done = call(*launcher, "serve-tea")
    assert (done.returncode, done.stdout) == (2, "")
    assert "league" in done.stderr


@pytest.mark.parametrize(("typed", "meant"), [("legaue", "league"), ("policy", "policies"), ("--verson", "--version")])
def test_a_command_that_is_nearly_one(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([typed]) == 2
    assert f"no command '{typed}'; did you mean {meant}" in capsys.readouterr().err


def test_the_pages_of_commands_are_their_help() -> None:
    command_reference.main(check=True)


@pytest.mark.parametrize("words", [["--help"], ["--version"]], ids=str)
def test_the_reader_of_the_output_closes_it_at_the_end(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    check_closed_pipe([sys.executable, "-m", "shuttle_marl", *words])


def test_policies_are_listed_with_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"shuttle_marl {shuttle_marl.__version__}\n"
    assert main(["policies", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert tuple(listed["policies"]) == registry.names(default_game())
    assert all(listed["policies"].values())
    assert {"agent:FOLDER", "table:FILE", "MODULE:ATTRIBUTE"} <= set(listed["forms"])
    assert all(listed["forms"].values())
    assert main(["policies"]) == 0
    shown = capsys.readouterr().out
    assert all(any(name in line.split() for line in shown.splitlines()) for name in listed["policies"])


def test_every_public_name_can_be_imported() -> None:
    assert "rally_v0" in shuttle_marl.__all__
    for name in shuttle_marl.__all__:
        assert getattr(shuttle_marl, name) is not None
    assert set(shuttle_marl.__all__) <= set(dir(shuttle_marl))


def test_printed_commands_name_the_interpreter_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = tmp_path / "my env"
    (environment / "bin").mkdir(parents=True)
    (environment / "bin" / "python").touch(0o755)
    monkeypatch.setattr(sys, "executable", str(environment / "bin" / "python"))
    monkeypatch.setenv("PATH", str(environment / "bin"))
    assert command("watch", "--replay", "a b.mcap") == "python -m shuttle_marl.watch --replay 'a b.mcap'"
    monkeypatch.setenv("PATH", "/nowhere")
    assert command("data") == f"'{environment}/bin/python' -m shuttle_marl.data"
    monkeypatch.chdir(tmp_path)
    assert command("data") == "'my env/bin/python' -m shuttle_marl.data"


def test_a_file_or_a_folder_with_content_is_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    (tmp_path / "file").touch()
    for name in ("empty", "new"):
        cli.check_free(tmp_path / name)
    for name in ("full", "file"):
        cli.check_free(tmp_path / name, overwrite=True)
        with pytest.raises(ShuttleError, match="already exists; --overwrite replaces it"):
            cli.check_free(tmp_path / name)


def test_what_is_read_is_not_overwritten(tmp_path: Path) -> None:
    folder, inside, other, link = (tmp_path / name for name in ("data", "data/a.csv", "b.csv", "c.csv"))
    replace_file(inside, b"a")
    replace_file(other, b"b")
    link.symlink_to(other)
    replace_file(folder / "report.html", b"c")
    missing = tmp_path / "missing"
    for written, read in (
        ([], []), ([tmp_path / "new.csv"], [folder, other]), ([folder / "report.html"], [folder]),
        ([folder / "new.csv"], [folder]),
        ([missing], [missing]), ([other], [inside]), ([tmp_path / "x", tmp_path / "y"], []),
    ):  # fmt: skip
        cli.check_apart(written, read)
    hard = tmp_path / "hard.csv"
    hard.hardlink_to(other)
    for out, source in ((other, other), (link, other), (other, link), (hard, other), (inside, folder), (folder, folder)):
        with pytest.raises(ShuttleError, match="is not written, because it is read too"):
            cli.check_apart([out], [source])


def test_a_command_does_not_write_over_its_inputs(tmp_path: Path) -> None:
    ran: list[Path] = []

    def serve(*, data: str, out: Path) -> None:
        """Serve."""
        ran.append(out)

    replace_file(tmp_path / "a", b"")
    for data, out, status in (("a", "b", 0), ("a", "a", 1), ("table:a", "a", 1), ("default", "a", 0)):
        with contextlib.chdir(tmp_path):
            assert cli.run(serve, prog="tea", description="", argv=["--data", data, "--out", out]) == status
    assert ran == [Path("b"), Path("a")]

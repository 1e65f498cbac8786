"""``python -m shuttle_marl.recording scene``."""

import contextlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from shuttle_marl.commands import cli
from shuttle_marl.files import replace_file
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.scene import SceneError
from shuttle_marl.text import printable

if TYPE_CHECKING:
    from shuttle_marl.scene.report import Resolve

Athlete = Literal["male", "female"]
Hand = Literal["right", "left"]
Meant = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=POLICY")]
Origins = Annotated[tuple[str, ...], tyro.conf.arg(metavar="ORIGIN")]

_HINT: Final = "--policy NAME=POLICY says what a name in the log stands for; --trust-policies runs what the log names"


def scene(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path | None = None,
    rally: int | None = None,
    match: int | None = None,
    pairing: int = 0,
    best: int | None = None,
    athletes: tuple[Athlete, Athlete] = ("male", "male"),
    hands: tuple[Hand, Hand] = ("right", "right"),
    fps: int = 50,
    game: str = "default",
    policy: Meant = (),
    trust_policies: bool = False,
    live: bool = False,
    port: int = 8765,
    origin: Origins = (),
) -> None:
    """Stage rallies in 3D for Foxglove or Lichtblick: write a file, or serve them.

    Args:
        path: a rally log, or a folder of them.
        out: the file to write, NAME.mcap.
        rally: number of the rally in the log.
        match: number of the match in its pairing.
        pairing: number of the pairing whose match is shown.
        best: show this many of the longest rallies.
        athletes: of seats 0 and 1.
        hands: with which seats 0 and 1 play.
        fps: frames a second, 25 to 50.
        game: model on whose game the rallies were played: a shipped one or a folder.
        policy: the policy that a name in the log stands for; a module or a file may be given here.
        trust_policies: take policies from the modules and files that the log names, which runs code that they hold.
        live: serve the scene to Foxglove on this machine until interrupted.
        port: to serve it on.
        origin: further web pages that may connect, such as https://viewer.example.org, beside those of Foxglove and this machine.
    """
    from rich.progress import track  # noqa: PLC0415  these keep --help quick

    from shuttle_marl.scene.live import bind, show_live  # noqa: PLC0415
    from shuttle_marl.scene.write import select, write_scene  # noqa: PLC0415

    if (out is None) != live:
        raise SceneError("say where the scene goes: either --out FILE or --live")
    console = cli.console(stderr=True)

    def progress(numbers: Sequence[int]) -> Iterable[int]:
        return track(numbers, "staging", console=console, transient=True)

    with bind(port) if live else contextlib.nullcontext() as listener:
        with RallyLog(path) as log:
            numbers = select(log, rally=rally, match=match, pairing=pairing, best=best)
            resolve = _resolver(policy, [player.name for player in log.policies], trust_policies)
            content, unknown = write_scene(
                log, numbers, load_game(game), athletes=athletes, handedness=hands, fps=fps, resolve=resolve, progress=progress
            )
        for name, reason in unknown.items():
            console.print(f"without probabilities of {name}: {reason}", soft_wrap=True)
        if unknown and not (trust_policies or policy):
            console.print(_HINT, soft_wrap=True)
        if listener is not None:
            show_live(content, listener, console, origins=origin)
    if out is not None:
        replace_file(out, content)
        size = f"{len(numbers):,} rallies, {len(content) / 1e6:.1f} MB"
        sys.stdout.write(f"{printable(str(out))}: {size}; open it in Foxglove or Lichtblick\n")


def _resolver(meant: Sequence[str], names: Sequence[str], trusted: bool) -> "Resolve":
    """Finds the policies of a log: those that the user names, else by the names in the log, trusted or not."""
    from shuttle_marl.policy.registry import resolve, resolve_recorded  # noqa: PLC0415

    given: dict[str, str] = {}
    for entry in meant:
        fitting = [name for name in names if entry.startswith(f"{name}=")]
        if not fitting:
            raise SceneError(f"--policy {entry}: expected NAME=POLICY with a name of the log, which has {', '.join(names)}")
        name = max(fitting, key=len)
        given[name] = entry.removeprefix(f"{name}=")

    def find(name: str, game: Game) -> Policy:
        if name in given:
            return resolve(given[name], game)
        return (resolve if trusted else resolve_recorded)(name, game)

    return find

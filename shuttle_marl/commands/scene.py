"""``python -m shuttle_marl.recording scene``."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from shuttle_marl.files import replace_file
from shuttle_marl.game.shipped import load_game
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.scene.errors import SceneError
from shuttle_marl.scene.selection import select

Athlete = Literal["male", "female"]
Hand = Literal["right", "left"]


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
    live: bool = False,
    port: int = 8765,
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
        live: serve the scene to Foxglove on this machine until interrupted.
        port: to serve it on.
    """
    from rich.progress import track  # noqa: PLC0415  these keep --help quick

    from shuttle_marl.scene.live import check_port, serve  # noqa: PLC0415
    from shuttle_marl.scene.write import film  # noqa: PLC0415

    if (out is None) != live:
        raise SceneError("say where the scene goes: either --out FILE or --live")
    if live:
        check_port(port)
    console = Console(stderr=True, soft_wrap=True)

    def progress(numbers: Sequence[int]) -> Iterable[int]:
        return track(numbers, "staging", console=console, transient=True)

    with RallyLog(path) as log:
        numbers = select(log, rally=rally, match=match, pairing=pairing, best=best)
        content, unknown = film(log, numbers, load_game(game), athletes=athletes, handedness=hands, fps=fps, progress=progress)
    for name, reason in unknown.items():
        console.print(f"[yellow]nothing is told of the choices of[/] {name}: {reason}", highlight=False)
    if out is not None:
        replace_file(out, content)
        sys.stdout.write(f"{out}: {len(numbers):,} rallies, {len(content) / 1e6:.1f} MB; open it in Foxglove or Lichtblick\n")
        return
    serve(content, port, console)

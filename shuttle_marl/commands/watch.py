"""``python -m shuttle_marl.watch``: a page on this machine that shows matches in 3D."""

import contextlib
import socket
import sys
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from shuttle_marl.commands import cli
from shuttle_marl.errors import printable
from shuttle_marl.game.shipped import Profile, resolve_game
from shuttle_marl.watch import WatchError

if TYPE_CHECKING:
    from shuttle_marl.watch.server import Server

Athlete = Literal["male", "female"]
Hand = Literal["right", "left"]


def watch(
    *,
    a: str = "ppo",
    b: str = "bc",
    temperature: tuple[float, float] = (1.0, 1.0),
    seed: int = 0,
    athletes: tuple[Athlete, Athlete] = ("male", "male"),
    hands: tuple[Hand, Hand] = ("right", "right"),
    replay: Path | None = None,
    real: Path | None = None,
    rally: int | None = None,
    record: Path = Path("runs/watch"),
    video: Path | None = None,
    game: str = "default",
    profile: Profile | None = None,
    host: str = "127.0.0.1",
    port: int = 8090,
    browser: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True,
) -> None:
    """Watch matches in 3D, analyse them, and play yourself: opens a page in the browser, served by this machine.

    Args:
        a: policy of the near player.
        b: policy of the far player.
        temperature: of both policies; 1: as they are, 0: always their likeliest stroke.
        seed: names all draws of the first match.
        athletes: who is seen at seats A and B.
        hands: with which they play.
        replay: show the rallies of this log instead of a match.
        real: show the rallies of annotated matches instead: a stroke table, or a folder with the raw files.
        rally: number of the rally that is shown first, from 0.
        record: folder for the log of rallies that you play.
        video: film the rally into this file, .mp4 or .webm, without a screen, and serve nothing.
        game: model on whose game they play: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        host: address to serve on; the default is for this machine alone.
        port: to serve on; if it is taken, a free one.
        browser: open the page in the browser.
    """
    from shuttle_marl.watch.answers import Answers  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.watch.building import BuildError, build  # noqa: PLC0415
    from shuttle_marl.watch.diary import Diary  # noqa: PLC0415
    from shuttle_marl.watch.plan import Side  # noqa: PLC0415
    from shuttle_marl.watch.recorded import LogRallies, RealRallies  # noqa: PLC0415
    from shuttle_marl.watch.server import Server, application, bind, hosts_of  # noqa: PLC0415
    from shuttle_marl.watch.stager import Stager  # noqa: PLC0415
    from shuttle_marl.watch.tables import Tables  # noqa: PLC0415
    from shuttle_marl.watch.video import check_video  # noqa: PLC0415

    console = cli.console(stderr=True)
    if replay is not None and real is not None:
        raise WatchError("say what to show: either --replay LOG or --real MATCH")
    if video is not None:
        check_video(video)
    sides = Side(policy=a, temperature=temperature[0]), Side(policy=b, temperature=temperature[1])
    try:
        page = build(lambda words: console.print(words, soft_wrap=True))
    except BuildError as error:
        raise WatchError(str(error)) from error
    found = resolve_game(game, profile)
    tables = Tables(found, (a, b))
    recorded = LogRallies(replay, found) if replay is not None else RealRallies(real, found) if real is not None else None
    if recorded is not None and not 0 <= (rally or 0) < recorded.count:
        raise WatchError(f"--rally {rally}: there are rallies 0 to {recorded.count - 1}")
    with contextlib.closing(bind(host, port)) as listener, contextlib.closing(Diary(record, found, tables)) as diary:
        answers = Answers(tables, sides, seed, Stager(found, athletes, hands), recorded=recorded, first=rally or 0, diary=diary)
        address = f"http://{f'[{host}]' if ':' in host else host}:{listener.getsockname()[1]}/"
        server = Server(application(answers, page, hosts=hosts_of(host)))
        if video is not None:
            _film(server, listener, f"{address}?quality=full#rally={(rally or 0) + 1}", video)
            return
        console.print(f"{address} shows the match; Ctrl-C ends it", soft_wrap=True)
        threading.Thread(target=answers.warm, daemon=True).start()
        if browser:
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


def _film(server: "Server", listener: socket.socket, address: str, path: Path) -> None:
    from rich.progress import track  # noqa: PLC0415

    from shuttle_marl.watch.video import write_video  # noqa: PLC0415

    console = cli.console(stderr=True)
    running = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    running.start()
    try:
        frames = write_video(address, path, lambda numbers: track(numbers, "filming", console=console, transient=True))
    finally:
        server.should_exit = True
        running.join()
    sys.stdout.write(f"{printable(str(path))}: {frames} frames, {path.stat().st_size / 1e6:.1f} MB\n")


COMMANDS: Final = watch


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return cli.run(COMMANDS, prog="python -m shuttle_marl.watch", description=watch.__doc__ or "", argv=argv)

"""``python -m shuttle_marl.staging measure``: stage rallies, and measure how believable their motion is."""

import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from shuttle_marl.commands import cli
from shuttle_marl.game.shipped import Profile, resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.reader import RallyLog

if TYPE_CHECKING:
    from shuttle_marl.staging import PlayedRally

Athlete = Literal["male", "female"]
Hand = Literal["right", "left"]
Log = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]

_LABELS: Final = {
    "contact_max": ("racket to shuttle at a contact, worst", "{:.4f} m"),
    "contact_within_1cm": ("contacts within a centimetre", "{:.1%}"),
    "slide_max": ("slide of a planted foot, worst", "{:.4f} m"),
    "sunk_max": ("foot below the floor, worst", "{:.4f} m"),
    "speed_max": ("speed of a player, greatest", "{:.2f} m/s"),
    "acceleration_max": ("acceleration of a player, greatest", "{:.2f} m/s²"),
    "joint_excess_deg": ("joint beyond its limit, worst", "{:.2f}°"),
    "net_clearance_min": ("shuttle over the net, least", "{:.4f} m"),
    "landing_error_max": ("end of a flight to the chosen point, worst", "{:.4f} m"),
    "ends_as_it_must": ("strokes that end as they must", "{:.1%}"),
    "flight_times_in_quartiles": ("flight times within the quartiles of their shot type", "{:.1%}"),
}
"""Labels and formats of the figures of :func:`shuttle_marl.staging.summary`."""


def measure(
    path: Log = None,
    *,
    rallies: int = 20,
    policies: tuple[str, str] = ("bc", "bc"),
    seed: int = 0,
    game: str = "default",
    profile: Profile | None = None,
    athletes: tuple[Athlete, Athlete] = ("male", "female"),
    hands: tuple[Hand, Hand] = ("right", "right"),
    fps: int = 50,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Stage rallies of a log, or simulated ones, and measure their motion.

    Args:
        path: a rally log, or a folder of them; without one, rallies are simulated.
        rallies: how many are staged, the first of the log.
        policies: of seats 0 and 1 in simulated rallies.
        seed: names all draws, of the staging and of simulated rallies.
        game: model on whose game the rallies are played: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        athletes: of seats 0 and 1.
        hands: with which seats 0 and 1 play.
        fps: frames a second.
        json_output: print JSON.
    """
    from rich.progress import track  # noqa: PLC0415  these keep --help quick

    from shuttle_marl.staging import StagingError, stage, summary  # noqa: PLC0415
    from shuttle_marl.staging import measure as measured  # noqa: PLC0415

    if rallies < 1:
        raise StagingError(f"--rallies {rallies}: expected 1 or more")
    tables = resolve_game(game, profile)
    played = _simulated(tables, policies, rallies, seed) if path is None else _recorded(path, tables, rallies)
    found = []
    for i, rally in enumerate(track(played, "staging", console=cli.console(stderr=True), transient=True)):
        found.append(measured(stage(rally, seed=seed + i, athletes=athletes, handedness=hands, fps=fps)))
    if not found:
        raise StagingError(f"{path}: holds no rallies")
    figures = summary(found)
    if json_output:
        sys.stdout.write(json.dumps(figures) + "\n")
        return
    rows = {label: text.format(figures[name]) for name, (label, text) in _LABELS.items() if name in figures}
    staged = f"{figures['rallies']:,} rallies, {figures['strokes']:,} strokes, {figures['seconds']:,.1f} s"
    cli.console().print(cli.facts({"staged": staged, **rows}))


def _simulated(game: Game, policies: tuple[str, str], rallies: int, seed: int) -> "Sequence[PlayedRally]":
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415
    from shuttle_marl.staging import play_rallies  # noqa: PLC0415

    first, second = (resolve(name, game) for name in policies)
    return play_rallies(game, (first, second), rallies, seed=seed)


def _recorded(path: Path, game: Game, rallies: int) -> "Iterator[PlayedRally]":
    from shuttle_marl.recording.replay import require_game  # noqa: PLC0415
    from shuttle_marl.staging.rally import recorded_rally  # noqa: PLC0415

    with RallyLog(path) as log:
        require_game(log, game)
        for number in itertools.islice(range(log.n_rallies), rallies):
            yield recorded_rally(log, number)


COMMANDS: Final[dict[str, cli.Command]] = {"measure": measure}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    return cli.run(COMMANDS, prog="python -m shuttle_marl.staging", description=__doc__ or "", argv=argv)

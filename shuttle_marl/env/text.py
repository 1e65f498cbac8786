"""A rally as text, for ``render_mode="ansi"``."""

from shuttle_marl.env.snapshot import Snapshot
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rally import OUTCOMES
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue


def as_text(snapshot: Snapshot) -> str:
    """Score, the strokes in words with their chances and outcomes, and how the rally stands."""
    names = snapshot.names
    lines = [f"{snapshot.title}, {names[snapshot.server]} serves"]
    lines += score_lines(snapshot)
    for number, stroke in enumerate(snapshot.strokes, start=1):
        words = in_words(snapshot.game.catalogue, stroke.stroke)
        chances = f"good {stroke.p_succ:6.1%}, returned {stroke.p_ret:6.1%}"
        lines.append(f"{number:3}  {names[stroke.player]}  {words:62} {chances}  {OUTCOMES[stroke.outcome]}")
    lines.append(standing(snapshot))
    return "\n".join(lines) + "\n"


def shot_in_words(catalogue: Catalogue, stroke: int) -> str:
    """The shot type in words: ``cross-court net shot``."""
    return SHOTS[catalogue.shot[stroke]].replace("-", " ").replace("cross court", "cross-court")


def in_words(catalogue: Catalogue, stroke: int) -> str:
    """A stroke in words: ``smash to the middle left, forehand above the net``."""
    area = AREAS[catalogue.area[stroke]].replace("-", " ")
    technique = TECHNIQUES[catalogue.technique[stroke]].replace("-", " ")
    return f"{shot_in_words(catalogue, stroke)} to the {area}, {technique} {HEIGHTS[catalogue.height[stroke]]} the net"


def score_lines(snapshot: Snapshot) -> list[str]:
    """One line a player with the points of every game; none where there is no match around the rally."""
    if not snapshot.by_game:
        return []
    width = max(map(len, snapshot.names))
    points = ["".join(f"{game[player]:4}" for game in snapshot.by_game) for player in (0, 1)]
    return [f"{name:{width}}{points[player]}" for player, name in enumerate(snapshot.names)]


def standing(snapshot: Snapshot) -> str:
    """Who is to hit, or who won and why."""
    names = snapshot.names
    if snapshot.striker is not None and snapshot.reason is None:
        return f"{names[snapshot.striker]} is to {'hit' if snapshot.strokes else 'serve'}"
    if snapshot.reason is None:
        return "no rally has begun"
    if snapshot.winner is None:
        return f"no result: {snapshot.reason}"
    text = f"{names[snapshot.winner]} wins the rally ({snapshot.reason})"
    return text if snapshot.match_winner is None else f"{text} and the match"

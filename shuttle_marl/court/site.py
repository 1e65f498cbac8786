"""A match as a folder of static files: the page, and the replies of the server that it reads instead."""

import gzip
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from shuttle_marl.base.files import replace_file
from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.building import FILES
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.server import CONTENT_POLICY, in_language
from shuttle_marl.court.staging import model_file
from shuttle_marl.reports.languages import Language

MAX_SITE: Final = 8_000_000  # default of the maximum size of a site [bytes]
_MARK: Final = b'<meta name="site" content="static">'  # in the first file that is written: no server answers
_REPLIES: Final = "replies"
_ROOM: Final = 600_000  # space for the overview of the match and the styles [bytes]


def save_site(
    folder: Path,
    page: Path,
    answers: Answers,
    progress: Callable[[int], object] = lambda _: None,
    *,
    language: Language = "en",
    limit: int = MAX_SITE,
) -> tuple[int, int, int]:
    """Write a site that every web server can serve; returns its number of rallies, its size [bytes], and the rallies left out.

    Args:
        folder: its folder; a site that is there is replaced.
        progress: receives the number of rallies so far.
        limit: maximum size [bytes]; rallies that do not fit are left out.

    Raises:
        WatchError: the folder has other files, recorded rallies are shown, or not even one rally fits.
        FileWriteError: a file cannot be written.
    """
    _check(folder)
    hello = answers.hello()
    if hello.recorded is not None:
        raise WatchError(f"--save-site {folder}: saves a match between policies; `report` writes pages of recorded matches")
    plan = hello.plan
    fixed = {name: (page / name).read_bytes() for name in FILES}
    # With the policy, which no server sends, and the mark of a site.
    policy = f'<meta http-equiv="Content-Security-Policy" content="{CONTENT_POLICY}">'.encode()
    index = in_language(fixed["index.html"], language)
    fixed["index.html"] = index.replace(b"<head>", b"<head>" + policy + _MARK, 1)
    rallies: dict[str, bytes] = {}
    size, count = sum(map(len, fixed.values())), 0
    for replies, athletes in _rallies(answers, plan):
        models = {f"{name}.glb": model_file(name).read_bytes() for name in athletes if f"{name}.glb" not in fixed}
        added = sum(map(len, replies.values())) + sum(map(len, models.values()))
        if size + added > limit - _ROOM:
            break
        rallies |= replies
        fixed |= models
        size, count = size + added, count + 1
        progress(count)
    if not count:
        raise WatchError(f"{folder}: the first rally does not fit into {limit / 1e6:.1f} MB")
    # The overview is that of the rallies that fit.
    rallies["match-0"] = _packed(answers, messages.MatchRequest(id=0, plan=plan, rally=count - 1, partial=True))
    rallies["styles"] = _packed(answers, messages.StylesRequest(id=0, plan=plan, rally=0))
    rallies["hello"] = gzip.compress(messages.encode_reply(0, replace(hello, rallies=count)), mtime=0)
    content = {**fixed, **{f"{_REPLIES}/{name}.bin": reply for name, reply in rallies.items()}}
    for name, data in content.items():
        replace_file(folder / name, data)
    for old in (folder / _REPLIES).glob("*.bin"):
        if old.stem not in rallies:
            old.unlink()
    return count, sum(map(len, content.values())), answers.length(plan) - count


def _check(folder: Path) -> None:
    if folder.is_file():
        raise WatchError(f"--save-site {folder}: a file has this name; give a folder")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    index = folder / "index.html"
    if not index.is_file() or _MARK not in index.read_bytes():
        raise WatchError(f"--save-site {folder}: the folder has other files; give a new or empty folder")


def _packed(answers: Answers, request: messages.Request) -> bytes:
    return gzip.compress(answers(request), mtime=0)


def _rallies(answers: Answers, plan: Plan) -> Iterator[tuple[dict[str, bytes], list[str]]]:
    for number in itertools.count():
        request = messages.RallyRequest(id=0, plan=plan, rally=number)
        facts = answers.rally(request)[0].rally
        replies = {f"rally-{number}": _packed(answers, request)}
        if facts.strokes:
            replies[f"analysis-{number}"] = _packed(answers, messages.AnalysisRequest(id=0, plan=plan, rally=number))
        yield replies, [player.athlete for player in facts.players]
        if facts.after is not None and facts.after.over:
            return

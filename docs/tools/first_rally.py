"""Stages the first rally of the default match, which the page shows before its server has compiled anything.

python -m docs.tools.first_rally
"""

import gzip

import msgspec

from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.options import Appearance
from shuttle_marl.commands.watch import GAME, MatchOptions
from shuttle_marl.court.answers import FIRST_RALLY, Answers, FirstRally, first_key
from shuttle_marl.court.match import PolicyTables
from shuttle_marl.court.messages import RallyRequest
from shuttle_marl.game.shipped import load_game


def first_rally() -> FirstRally:
    """The first rally of the default match."""
    game, match, appearance = load_game(GAME), MatchOptions(), Appearance()
    plan, (athletes, hands) = match.plan(game), (appearance.athletes, appearance.hands)
    answers = Answers(PolicyTables(game), plan, athletes=athletes, hands=hands)
    reply, motion = answers.rally(RallyRequest(id=0, plan=plan, rally=0))
    return FirstRally(first_key(game, plan, athletes, hands), reply, motion)


if __name__ == "__main__":
    replace_file(FIRST_RALLY, gzip.compress(msgspec.msgpack.encode(first_rally()), mtime=0))

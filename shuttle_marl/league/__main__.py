"""``python -m shuttle_marl.league``: the command in :mod:`shuttle_marl.commands.league`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["league", *sys.argv[1:]]))

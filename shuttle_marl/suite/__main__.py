"""``python -m shuttle_marl.suite``: the command in :mod:`shuttle_marl.commands.suite`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["suite", *sys.argv[1:]]))

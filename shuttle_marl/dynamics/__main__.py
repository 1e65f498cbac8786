"""``python -m shuttle_marl.dynamics``: the command in :mod:`shuttle_marl.commands.dynamics`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["dynamics", *sys.argv[1:]]))

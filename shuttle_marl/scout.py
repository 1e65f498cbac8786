"""``python -m shuttle_marl.scout``: the command in :mod:`shuttle_marl.commands.scout`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["scout", *sys.argv[1:]]))

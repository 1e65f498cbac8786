"""``python -m shuttle_marl.training``: the command in :mod:`shuttle_marl.commands.training`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["training", *sys.argv[1:]]))

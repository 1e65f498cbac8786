"""``python -m shuttle_marl.watch``: the command in :mod:`shuttle_marl.commands.watch`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["watch", *sys.argv[1:]]))

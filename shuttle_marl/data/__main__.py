"""``python -m shuttle_marl.data``: the command in :mod:`shuttle_marl.commands.data`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["data", *sys.argv[1:]]))

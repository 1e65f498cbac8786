"""``python -m shuttle_marl.analysis``: the command in :mod:`shuttle_marl.commands.analysis`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["analysis", *sys.argv[1:]]))

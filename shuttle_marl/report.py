"""``python -m shuttle_marl.report``: the command in :mod:`shuttle_marl.commands.report`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["report", *sys.argv[1:]]))

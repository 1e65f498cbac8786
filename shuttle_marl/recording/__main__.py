"""``python -m shuttle_marl.recording``: the command in :mod:`shuttle_marl.commands.recording`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["recording", *sys.argv[1:]]))

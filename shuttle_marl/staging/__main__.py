"""``python -m shuttle_marl.staging``: the command in :mod:`shuttle_marl.commands.staging`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["staging", *sys.argv[1:]]))

"""The commands: ``python -m shuttle_marl.X`` and ``shuttle-marl X`` call ``shuttle_marl.commands.X``."""

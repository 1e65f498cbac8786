"""The commands: ``python -m shuttle_marl.NAME`` and ``shuttle-marl NAME`` call the module ``NAME`` of this folder."""

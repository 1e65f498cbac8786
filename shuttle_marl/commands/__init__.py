"""The commands: ``shuttle-marl NAME`` calls the module ``NAME`` of this folder."""

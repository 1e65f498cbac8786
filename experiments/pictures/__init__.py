"""Pictures of scene files, drawn from their messages alone, without a viewer: for the documentation, and to check scenes."""

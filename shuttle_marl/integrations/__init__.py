"""The game in the words of other libraries, each in a module of its own that needs that library."""

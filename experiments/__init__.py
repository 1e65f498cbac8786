"""One script per table or figure of the paper, and per result of our own."""

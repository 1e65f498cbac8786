"""Reports of tournaments and training runs as self-contained HTML files."""

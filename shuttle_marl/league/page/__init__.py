"""Reports of tournaments and training runs as one HTML file each, which asks for nothing from anywhere."""

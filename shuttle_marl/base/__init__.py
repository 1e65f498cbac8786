"""What every package uses: files, run folders, errors, array types, the compiler, and the machines of a cluster."""

"""What every layer stands on: errors, files written whole or not at all, worker processes, arrays, the version."""

"""``python -m tests.fuzz``; in a module of its own, because workers are spawned."""

from tests.fuzz.run import main

main()

"""``python -m hexmap``."""

from importlib import import_module

# Looked up by name, because the library itself must not depend on its command line.
import_module("hexmap.cli").program()

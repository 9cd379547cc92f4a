"""``python -m hexmap``."""

import sys
from importlib import import_module

# Looked up by name, because the library itself must not depend on its command line.
sys.exit(import_module("hexmap.cli").main())

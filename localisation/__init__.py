"""Scan matching, mapping from logs, and their evaluation; a part of hexmap."""

from __future__ import annotations

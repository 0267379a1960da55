"""Panels: the sidebar tab "GRMM" and the object data tab."""

from __future__ import annotations

CLASSES = ()

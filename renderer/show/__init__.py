"""Datasets for people: pages, contact sheets, GIFs and videos."""

from __future__ import annotations

from .driver import show
from .html import render_page
from .overlay import Painter

__all__ = ["Painter", "render_page", "show"]

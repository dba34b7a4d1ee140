"""Devices that each run their own SLAM, put into one frame from nothing but the distances between them."""

from __future__ import annotations

"""Bytes to data and back: each format in one file."""

"""Formats: bytes to data and back, each format in one file or one pair of files."""

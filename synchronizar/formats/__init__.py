"""Codecs: files on disk <-> tracks, ranges and settings. A fault in a file is told with its name and line."""

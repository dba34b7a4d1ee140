"""Robots as such, whatever they are asked to do: what moves, how it drives, what it sees, how it keeps off people."""

"""Computing time and memory."""

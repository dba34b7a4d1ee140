"""Applications on a room's protocol: each is found by its entry point, as anybody else's would be."""

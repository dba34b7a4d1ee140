"""From range measurements to each user's frame, its uncertainty and a verdict on it."""

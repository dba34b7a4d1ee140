"""From range measurements to everybody's frame and a verdict on it."""

"""The live room: devices join, walk, and are in one frame."""

"""The vehicles of a mission: who is left, their cables, and how each flies by itself."""

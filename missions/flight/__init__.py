"""One flight: its processes, its progress on a terminal, and its summary."""

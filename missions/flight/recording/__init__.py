"""The log process: what it is told over pipes, merged in order and recorded."""

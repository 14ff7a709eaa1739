"""Logs read: records, messages, columns by name, checks of soundness, export."""

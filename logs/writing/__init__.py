"""Logs written: values to messages, messages to MCAP."""

"""Every run as one MCAP file: written, read back, replayed."""

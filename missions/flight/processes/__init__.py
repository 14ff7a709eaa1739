"""Processes of a flight beside the control loop: simulator, log, autopilots, viewer, and their places."""

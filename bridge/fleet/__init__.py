"""n autopilots: connecting, modes, arming, streams, and the thrust that each is asked for."""

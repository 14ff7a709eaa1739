"""What acts on the model in flight: air, ground, rotors, and the compiled step of all of it together."""

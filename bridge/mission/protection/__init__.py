"""What goes wrong in a mission, how it is found, and what is done then."""

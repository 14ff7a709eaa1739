"""The control loop: measured states in, one decision for each, setpoints out, on the vehicles' clock."""

"""What is found out of a scenario or a log: check, margins, drills, preflight, identification, control replay."""

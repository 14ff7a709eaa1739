"""The conductor: scenarios, the `cablequad` command, and what composes vehicles, bridge and log."""

"""What a vehicle answers: messages in, messages out, as transition tables. No socket and no clock in here."""

"""What can be said of a design: margins, the certificate of Proposition 3, a flight without a wire."""

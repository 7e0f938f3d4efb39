"""What may be tuned and where things are; read by flows and server only."""

"""`clgs run`: its plan, its stages, and the record that it goes on from."""

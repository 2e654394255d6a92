"""Studies: one question each, answered with numbers that one command recomputes."""

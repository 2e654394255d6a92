"""How fast the solver is: beside other ways to compute the same iterations, and beside what the machine can move."""

"""The recovery problem and its solver: Algorithm 1 of Yang et al. 2020 as init, step and terminate under one loop."""

from motionrecover.solver.loop import solve
from motionrecover.solver.problem import Problem
from motionrecover.solver.result import Result, Solution, Trace
from motionrecover.solver.step import Info, Solver, State

__all__ = ["Info", "Problem", "Result", "Solution", "Solver", "State", "Trace", "solve"]

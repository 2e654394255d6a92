"""The recovery problem and its two solvers, each as init, step and terminate, under one loop.

`step` is Algorithm 1 of Yang et al. 2020, `smoother` the robust recovery.
"""

from motionrecover.solver.loop import solve
from motionrecover.solver.problem import Guide, Problem
from motionrecover.solver.result import Result, Solution, Trace
from motionrecover.solver.smoother import Smoother, SmootherInfo, SmootherState
from motionrecover.solver.step import Info, Solver, State

__all__ = [
    "Guide",
    "Info",
    "Problem",
    "Result",
    "Smoother",
    "SmootherInfo",
    "SmootherState",
    "Solution",
    "Solver",
    "State",
    "Trace",
    "solve",
]

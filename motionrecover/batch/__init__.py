"""Whole archives: every motion file of a folder, a pattern or a list recovered into another folder.

    jobs = plan(["archive"], "clean")
    tally = run(jobs, "clean", Settings(), Processes(4))

A batch that dies loses the clips at hand and nothing else; the same call goes on where it ended.
"""

from motionrecover.batch.clip import Settings
from motionrecover.batch.cluster import Dask
from motionrecover.batch.driver import Tally, run
from motionrecover.batch.jobs import Job, plan
from motionrecover.batch.lock import Locked
from motionrecover.batch.workers import Executor, Processes, WorkerLost

__all__ = ["Dask", "Executor", "Job", "Locked", "Processes", "Settings", "Tally", "WorkerLost", "plan", "run"]

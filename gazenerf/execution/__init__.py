"""Work on many items, here, in processes of this machine, or on the workers of a Dask cluster."""

from gazenerf.execution.failures import Failures
from gazenerf.execution.job import Job, Tell, require_shared
from gazenerf.execution.options import HERE, ExecutionOptions, Where
from gazenerf.execution.results import Done, results

__all__ = [
    "HERE",
    "Done",
    "ExecutionOptions",
    "Failures",
    "Job",
    "Tell",
    "Where",
    "require_shared",
    "results",
]

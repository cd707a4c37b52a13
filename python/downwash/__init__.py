"""downwash: simulate, learn, plan and diagnose quadrotors.

World axes are north, east, down; body axes are front, right, down. Units are SI and radians; names end in
the unit. Errors raise `DownwashError` with the command line's message and its ``exit_code``; an argument
that is invalid by itself raises ValueError or TypeError.
"""

from ._compare import Comparison, compare
from ._diagnosis import Diagnosis, diagnose
from ._downwash import DownwashError, __version__
from ._fleet import Fleet
from ._flight import fly
from ._log import Log, Stream, audit, read
from ._model import ACCELERATIONS, INPUT, MOTION, Learner, Model
from ._onset import Changes, onset
from ._plan import PLAN_INPUT, PLAN_STATE, Plan, plan
from ._plant import REST, STATE, Plant, rollouts
from ._rows import Rows
from ._sweep import sweep, table
from ._trajectory import POINT, Trajectory
from ._vehicle import Vehicle, effects

__all__ = [
    "ACCELERATIONS",
    "INPUT",
    "MOTION",
    "PLAN_INPUT",
    "PLAN_STATE",
    "POINT",
    "REST",
    "STATE",
    "Changes",
    "Comparison",
    "Diagnosis",
    "DownwashError",
    "Fleet",
    "Learner",
    "Log",
    "Model",
    "Plan",
    "Plant",
    "Rows",
    "Stream",
    "Trajectory",
    "Vehicle",
    "__version__",
    "audit",
    "compare",
    "diagnose",
    "effects",
    "fly",
    "onset",
    "plan",
    "read",
    "rollouts",
    "sweep",
    "table",
]

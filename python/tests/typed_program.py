"""A user's program, which the type checker reads and nothing runs: each public name as it is used."""

from pathlib import Path

import downwash as dw
import numpy as np

logs = Path("flights").glob("*.ulg")
scale = np.ones(3)
effects: dw.Rows = dw.effects()
vehicle = dw.Vehicle("crazyflie").with_effects({"inertia": {"scale": scale}, "wind": {"north_m_s": 2}})
law = {"drag": {"force_x": "-0.02[kg/s] * air_x"}}
plant = dw.Plant(vehicle, {"law": law}, state=dw.REST)
plant.state = plant.step([0.5] * 4)
north_m: float = plant.rollout(np.full((3, 4), 0.5, np.float32))[0, dw.STATE.index("north_m")]
fleet = dw.Fleet(3, dtype="f4").copy()
states = fleet.step(dw.rollouts(np.zeros((3, 1, 4)), effects=[{}, {}, {}])[:, 0, :4])
trajectory = dw.Trajectory({"family": "hover", "altitude_m": 1.0, "duration_s": 2.0})
rows = dw.fly(vehicle, trajectory, {"mass": {"mass_kg": 0.03}}, seeds=np.arange(3), onsets=[(2.0, {})])
plan: dw.Plan = dw.plan(trajectory, vehicle, settings={"plan.rate_hz": 50.0})
log: dw.Log = dw.read("flight.ulg")
stream: dw.Stream = log["position"]
learner = dw.Learner(vehicle, passes=3).fit(logs)
model: dw.Model = learner.model_
accelerations, slopes = model.accelerations(np.zeros((2, 9)), np.zeros((2, 4)), jacobian=True)
found: dw.Diagnosis = dw.diagnose(vehicle, sorted(logs), without=("wind",), holdout=logs)
compared: dw.Comparison = dw.compare("a.mcap", ["b.mcap"], align="phase")
changes: dw.Changes = dw.onset("crazyflie", logs)
summary = dw.sweep("sweep.toml", "out", shard=(1, 2), progress=lambda stage, done, of: None)
dw.table("out").to_parquet("table.parquet")
audited = dw.audit(log.facts["path"])
names = (*dw.POINT, *dw.PLAN_STATE, *dw.PLAN_INPUT, *dw.MOTION, *dw.INPUT, *dw.ACCELERATIONS)
code: int = dw.DownwashError("refused").exit_code

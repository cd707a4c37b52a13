"""The planning problem in CasADi and IPOPT: `python plan_ipopt.py FOLDER MODEL PERIODS [WIDTH]`, prints JSON.

Direct multiple shooting from the desired states and hover, exact Hessian, MUMPS. MODEL is physics or nets. A WIDTH
above 0 rounds the networks' ReLUs off to `(x + sqrt(x^2 + WIDTH^2)) / 2` for the search: with their kinks IPOPT
does not converge. The printed result always uses the exact model, and the time is the search's only.
"""

import json
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np

folder, model, periods = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
width = float(sys.argv[4]) if len(sys.argv) > 4 else 0.0
read = lambda name: json.loads((folder / f"{name}.json").read_text())
params, nets, course = read("params"), read("nets"), read(f"traj_sinyaw{periods}")
scale = np.array(params["u_scale"])
desired = np.array(course["sd"]).T[:, 1:]


def turn(axis, angle):
    """Rotation about the axis 0, 1 or 2."""
    c, s = ca.cos(angle), ca.sin(angle)
    rows = {0: [[1, 0, 0], [0, c, -s], [0, s, c]], 1: [[c, 0, s], [0, 1, 0], [-s, 0, c]], 2: [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    return ca.vertcat(*(ca.horzcat(*row) for row in rows[axis]))


def physics(v, attitude, rate, u):
    to_world = turn(2, attitude[2]) @ turn(1, attitude[1]) @ turn(0, attitude[0])
    drag, inertia, damping = (ca.DM(params[key]) for key in ("drag_body", "inertia", "ang_drag"))
    force = -drag * (to_world.T @ v) - ca.vertcat(0, 0, u[0])
    moment = u[1:] - ca.cross(rate, inertia * rate) - damping * rate
    return to_world @ force / params["mass"] + ca.vertcat(0, 0, params["gravity"]), moment / inertia


def learned(v, attitude, rate, u, round_off):
    def evaluate(net, x):
        column = {key: ca.DM(net[key]) for key in net}
        h = column["W1"] @ ((x - column["in_mean"]) / column["in_std"]) + column["b1"]
        h = (h + ca.sqrt(h**2 + round_off**2)) / 2 if round_off else ca.fmax(h, 0)
        return (column["W2"] @ h + column["b2"]) * column["out_std"] + column["out_mean"]

    seen = ca.vertcat(v, rate, ca.sin(attitude), ca.cos(attitude))
    return evaluate(nets["nn1"], ca.vertcat(seen, u[0])), evaluate(nets["nn2"], ca.vertcat(seen, u[1:]))


def euler_step(round_off):
    s, w = ca.SX.sym("s", 12), ca.SX.sym("w", 4)
    v, attitude, rate, u = s[3:6], s[6:9], s[9:12], w * scale
    roll, pitch = attitude[0], attitude[1]
    across = ca.sin(roll) * rate[1] + ca.cos(roll) * rate[2]
    turning = ca.vertcat(
        rate[0] + ca.tan(pitch) * across, ca.cos(roll) * rate[1] - ca.sin(roll) * rate[2], across / ca.cos(pitch)
    )
    arguments = (v, attitude, rate, u)
    linear, angular = physics(*arguments) if model == "physics" else learned(*arguments, round_off)
    return ca.Function("step", [s, w], [s + course["dt"] * ca.vertcat(v, linear, turning, angular)])


# One vector (w_0, s_1, w_1, s_2, ...) makes the equations banded.
x = ca.MX.sym("x", 16, periods)
inputs, states = x[:4, :], x[4:, :]
before = ca.horzcat(ca.DM(course["s0"]), states[:, :-1])
ahead = euler_step(width).map(periods)(before, inputs)
apart = ca.sqrt(ca.sum1((states - desired) ** 2) + 1e-10)
programme = {"x": ca.vec(x), "f": ca.sum2(apart), "g": ca.vec(states - ahead)}
quiet = {"print_level": 0, "sb": "yes", "linear_solver": "mumps", "tol": 1e-6, "max_iter": 500}
solver = ca.nlpsol("solver", "ipopt", programme, {"print_time": False, "ipopt": quiet})

column = lambda w, s: np.concatenate([w, s], axis=0).T.ravel()
bound = lambda key, sign: column(
    np.tile((np.array(params[key]) / scale)[:, None], periods), np.full((12, periods), sign * np.inf)
)
hover = np.tile((np.array(params["u_hover"]) / scale)[:, None], periods)
begun, cpu = time.perf_counter(), time.process_time()
found = solver(x0=column(hover, desired), lbx=bound("u_min", -1), ubx=bound("u_max", 1), lbg=0, ubg=0)
seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu

x = np.array(found["x"]).reshape(periods, 16).T
starts = np.column_stack([course["s0"], x[4:, :-1]])
exact = np.array(euler_step(0.0).map(periods)(starts, x[:4]))
tool = f"IPOPT, width {width:g}" if width else "IPOPT"
print(json.dumps({
    "tool": tool, "model": model, "periods": periods, "start": "cold", "seconds": seconds, "least_s": seconds,
    "cpu_s": cpu, "cost": float(np.linalg.norm(x[4:] - desired, axis=0).sum()),
    "defect": float(np.abs(exact - x[4:]).max()), "subproblems": 0, "iterations": solver.stats()["iter_count"],
    "status": solver.stats()["return_status"],
}))

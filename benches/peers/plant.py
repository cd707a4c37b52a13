"""Vehicle steps per second of a peer's batch on one core: `python plant.py crazyflow|rotorpy`.

Prints one JSON object per line, like `cargo bench -p downwash-vehicle --bench batch`. Pin it to one core.
"""

import json
import os
import sys
import time

RUNS = 7
RUN_S = 0.3

# One core: otherwise JAX would start a thread pool.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")


def best(step, steps_a_call):
    """Steps per second, the best of several short runs: other load on the machine only takes time away."""
    step()
    rates = []
    for _ in range(RUNS):
        began, calls = time.perf_counter(), 0
        while time.perf_counter() - began < RUN_S:
            step()
            calls += 1
        rates.append(calls * steps_a_call / (time.perf_counter() - began))
    return max(rates)


def report(tool, precision, what, vehicles, rate):
    row = {"tool": tool, "precision": precision, "what": what, "vehicles": vehicles, "steps_per_s": round(rate)}
    print(json.dumps(row), flush=True)


def crazyflow():
    import jax
    import numpy as np
    from crazyflow.control import Control
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim
    from crazyflow.sim.integration import Integrator

    inner = 20
    for integrator in (Integrator.rk4, Integrator.euler):
        for worlds in (1024, 16384):
            sim = Sim(
                n_worlds=worlds,
                dynamics=Dynamics.first_principles,
                control=Control.rotor_vel,
                integrator=integrator,
            )
            # Off the floor, which stops falling vehicles.
            position = sim.data.states.pos.at[..., 2].set(1000.0)
            sim.data = sim.data.replace(states=sim.data.states.replace(pos=position))
            # Below hover: the vehicle sinks slowly.
            sim.rotor_vel_control(np.full((worlds, 1, 4), 14_000.0, np.float32))

            def step(sim=sim):
                sim.step(inner)
                jax.block_until_ready(sim.data.states.pos)

            report("crazyflow", "f32", f"rotor lag and drag, {integrator}", worlds, best(step, inner * worlds))
            sim.close()


def rotorpy():
    import numpy as np
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    state = {
        "x": np.array([0.0, 0.0, 100.0]),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, 1788.53),
    }
    vehicle = Multirotor(quad_params, initial_state=state, control_abstraction="cmd_motor_speeds")
    flown = [state]

    def step():
        flown[0] = vehicle.step(flown[0], {"cmd_motor_speeds": np.full(4, 1780.0)}, 0.001)

    report("rotorpy", "f64", "one vehicle, rotor lag and drag, adaptive RK45", 1, best(step, 1))
    try:
        import torch
        from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams
    except ImportError:
        return
    torch.set_num_threads(1)
    for count in (1024, 16384):
        device = torch.device("cpu")
        params = BatchedMultirotorParams([quad_params] * count, count, device)
        states = {key: torch.tensor(np.tile(value, (count, 1))) for key, value in state.items()}
        many = BatchedMultirotor(
            params, count, states, device, control_abstraction="cmd_motor_speeds", integrator="rk4"
        )
        speeds = torch.full((count, 4), 1780.0, dtype=torch.float64)
        held = [states]

        def step(many=many, held=held, speeds=speeds):
            held[0] = many.step(held[0], {"cmd_motor_speeds": speeds}, 0.001)

        report("rotorpy", "f64", "batched, rotor lag and drag, RK4", count, best(step, count))


if __name__ == "__main__":
    {"crazyflow": crazyflow, "rotorpy": rotorpy}[sys.argv[1]]()

"""One peer's training, timed: `python train.py numpy|torch FILE THREADS PASSES`, prints JSON.

Full-batch Rprop on both networks of FILE, one hidden layer of 100 ReLUs, as in `benches/training.rs`.
Only the passes are timed, not the reading of the rows or the printed errors.
"""

import json
import os
import resource
import sys
import time

tool, path, threads, passes = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = str(threads)

import numpy as np  # noqa: E402  (reads the variables above)

import data  # noqa: E402

HIDDEN = 100
FIRST_STEP, SHRINKAGE, GROWTH, LEAST, MOST = 1e-3, 0.5, 1.2, 1e-6, 50.0


def clocks():
    """Wall and CPU seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def first_parameters(inputs, outputs, random):
    """Initial weights with the distribution of torch.nn.Linear."""
    uniform = lambda fan, *shape: random.uniform(-1, 1, shape).astype("f4") / np.float32(fan**0.5)
    hidden = [uniform(inputs, inputs, HIDDEN), uniform(inputs, HIDDEN)]
    return hidden + [uniform(HIDDEN, HIDDEN, outputs), uniform(HIDDEN, outputs)]


def forward(parameters, inputs):
    w, b, v, c = parameters
    return np.maximum(inputs @ w + b, 0) @ v + c


def train_numpy(inputs, targets, random):
    """Explicit back-propagation: each array is allocated once, each product is one BLAS call."""
    parameters = first_parameters(inputs.shape[1], targets.shape[1], random)
    steps = [np.full_like(p, FIRST_STEP) for p in parameters]
    last = [np.zeros_like(p) for p in parameters]
    h = np.empty((len(inputs), HIDDEN), "f4")
    d = np.empty_like(h)
    active = np.empty(h.shape, bool)
    error = np.empty_like(targets)

    start = clocks()
    for _ in range(passes):
        w, b, v, c = parameters
        np.matmul(inputs, w, out=h)
        np.add(h, b, out=h)
        np.maximum(h, 0, out=h)
        np.matmul(h, v, out=error)
        np.add(error, c, out=error)
        np.subtract(error, targets, out=error)
        np.multiply(error, np.float32(2 / targets.size), out=error)
        np.matmul(error, v.T, out=d)
        np.greater(h, 0, out=active)
        np.multiply(d, active, out=d)
        gradient = [inputs.T @ d, d.sum(0), h.T @ error, error.sum(0)]
        for p, g, step, old in zip(parameters, gradient, steps, last):
            turn = g * old
            step *= np.where(turn > 0, GROWTH, np.where(turn < 0, SHRINKAGE, 1)).astype("f4")
            np.clip(step, LEAST, MOST, out=step)
            g[turn < 0] = 0
            p -= np.sign(g) * step
            old[:] = g
    return clocks() - start, parameters


def train_torch(inputs, targets, seed):
    import torch

    torch.set_num_threads(threads)
    torch.manual_seed(seed)
    net = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], HIDDEN),
        torch.nn.ReLU(),
        torch.nn.Linear(HIDDEN, targets.shape[1]),
    )
    inputs, targets = torch.from_numpy(inputs), torch.from_numpy(targets)
    optimizer = torch.optim.Rprop(net.parameters(), lr=FIRST_STEP)

    start = clocks()
    for _ in range(passes):
        optimizer.zero_grad()
        torch.nn.functional.mse_loss(net(inputs), targets).backward()
        optimizer.step()
    taken = clocks() - start
    w, b, v, c = [parameter.detach().numpy() for parameter in net.parameters()]
    return taken, [w.T, b, v.T, c]


total, errors = np.zeros(2), []
for number, (training, _, test) in enumerate(data.read(path)):
    if tool == "numpy":
        taken, parameters = train_numpy(*training, np.random.default_rng(number))
    else:
        taken, parameters = train_torch(*training, number)
    total += taken
    mse = lambda part: float(((forward(parameters, part[0]) - part[1]).astype("f8") ** 2).mean())
    errors.append({"training": mse(training), "test": mse(test)})
print(json.dumps({
    "tool": tool, "threads": threads, "passes": passes, "seconds": total[0], "cpu_s": total[1],
    "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "errors": errors,
}))

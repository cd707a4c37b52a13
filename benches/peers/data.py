"""The problem that all tools of this folder learn: a small quadrotor's accelerations.

`python data.py FILE` writes 240,000 rows, 60/25/15 % for training, validation and test, as

    8 bytes  magic "DWTRAIN1"
    per network (linear, angular): u32 inputs, u32 outputs, then per part u32 rows
    per network and part: rows x (inputs + outputs) f32, row-major, little-endian, normalised
    by the mean and deviation of the training part

States are drawn from the envelope of ordinary flight, not flown: the timing is the same for any rows,
and the errors of all tools are compared on the same rows.
"""

import sys

import numpy as np

ROWS = 240_000
PARTS = (0.60, 0.25, 0.15)
MASS, GRAVITY = 0.03, 9.81
INERTIA = np.array([1.43e-5, 1.43e-5, 2.57e-5])
DRAG = np.array([6.6e-3, 6.6e-3, 7.4e-3])
DAMPING = 1e-6


def body_to_world(attitude):
    """Rotation matrices of roll, pitch, yaw (z-y-x), one per row."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(attitude).T, np.cos(attitude).T
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def problem():
    """Yields the inputs and targets of the two networks, before normalisation."""
    random = np.random.default_rng(7)
    draw = lambda *deviations: random.normal(0, deviations, (ROWS, len(deviations)))
    velocity = draw(0.55, 0.5, 0.5)
    attitude = np.column_stack([draw(0.13, 0.13), random.uniform(-np.pi, np.pi, ROWS)])
    rate = draw(0.85, 0.85, 0.95)
    thrust = MASS * GRAVITY + draw(0.05)[:, 0]
    moment = draw(3.3e-4, 3.3e-4, 1.2e-4)

    rotation = body_to_world(attitude)
    body_velocity = np.einsum("nji,nj->ni", rotation, velocity)
    force = -DRAG * body_velocity
    force[:, 2] -= thrust
    linear = np.einsum("nij,nj->ni", rotation, force) / MASS + [0, 0, GRAVITY]
    angular = (moment - np.cross(rate, INERTIA * rate) - DAMPING * rate) / INERTIA

    common = [velocity, rate, np.sin(attitude), np.cos(attitude)]
    yield np.column_stack([*common, thrust]), linear + draw(*[0.05] * 3)
    yield np.column_stack([*common, moment]), angular + draw(*[0.5] * 3)


def write(path):
    ends = np.cumsum([round(ROWS * part) for part in PARTS])
    networks = []
    for inputs, targets in problem():
        rows = np.column_stack([inputs, targets])
        training = rows[: ends[0]]
        rows = ((rows - training.mean(0)) / training.std(0)).astype("<f4")
        networks.append((inputs.shape[1], targets.shape[1], np.split(rows, ends[:2])))
    with open(path, "wb") as file:
        file.write(b"DWTRAIN1")
        for inputs, outputs, parts in networks:
            sizes = [inputs, outputs, *(len(part) for part in parts)]
            file.write(np.array(sizes, "<u4").tobytes())
        for _, _, parts in networks:
            for part in parts:
                file.write(part.tobytes())


def read(path):
    """A list of networks: for each part the inputs and the targets."""
    with open(path, "rb") as file:
        assert file.read(8) == b"DWTRAIN1", f"{path}: expected a file that data.py wrote"
        heads = np.frombuffer(file.read(40), "<u4").reshape(2, 5).astype(int)
        networks = []
        for inputs, outputs, *parts in heads:
            columns = inputs + outputs
            read_rows = lambda rows: np.frombuffer(file.read(4 * rows * columns), "<f4")
            rows = [read_rows(part).reshape(part, columns) for part in parts]
            split = [np.split(part, [inputs], axis=1) for part in rows]
            networks.append([[np.ascontiguousarray(side) for side in part] for part in split])
        return networks


if __name__ == "__main__":
    write(sys.argv[1])

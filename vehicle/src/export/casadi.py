import casadi as cs

# Position and velocity (north, east, down), rotation from body to world (w, x, y, z), body rate
# (front, right, down); with a lag, the rotors' states too, thrust over full thrust of each.
STATES = 17 if LAG > 0 else 13


def to_body(q, v):
    """A vector of world axes in body axes."""
    r = -q[1:]
    return v + 2 * cs.cross(r, cs.cross(r, v) + q[0] * v)


def to_world(q, v):
    """A vector of body axes in world axes."""
    r = q[1:]
    return v + 2 * cs.cross(r, cs.cross(r, v) + q[0] * v)


def thrust_factor(flow, height):
    """What the air does to the rotors' thrust: ground effect, translational lift, vortex ring."""
    across2 = flow[0] ** 2 + flow[1] ** 2
    factor = 1 + cs.fmin(LIFT * across2, 0.5)
    if GROUND_RADIUS > 0:
        quarter2 = (GROUND_RADIUS / 4) ** 2
        is_above = cs.logic_and(height > 0, 0.35 * height**2 > quarter2)
        near = height**2 / cs.if_else(is_above, height**2 - quarter2, 1)
        factor *= cs.if_else(is_above, near, 1 / 0.65)
    if RING_LOSS > 0:
        descent = flow[2] / INDUCED_VELOCITY - RING_ONSET
        x = cs.fmin(cs.fmax(descent / max(RING_FULL - RING_ONSET, 1e-12), 0), 1)
        clearing = cs.exp(-across2 / INDUCED_VELOCITY**2)
        factor *= 1 - RING_LOSS * x**2 * (3 - 2 * x) * clearing
    return factor


def dynamics():
    """The state's rate of change as a function of the state, four motor outputs in 0..1, and the
    pack's voltage (V)."""
    state = cs.MX.sym("state", STATES)
    outputs = cs.MX.sym("outputs", 4)
    voltage = cs.MX.sym("voltage_v")
    velocity, q, rate = state[3:6], state[6:10], state[10:13]
    rotors = state[13:] if LAG > 0 else outputs
    rotors_dot = (outputs - rotors) / LAG if LAG > 0 else cs.MX.zeros(4)

    share = THRUST_CURVE * rotors**2 + (1 - THRUST_CURVE) * rotors
    if SAG_EXPONENT > 0:
        share *= (voltage / FULL_VOLTAGE) ** SAG_EXPONENT
    thrusts = cs.DM(THRUST_MAX) * share
    speeds = cs.sqrt(cs.fmax(share, 1e-12))
    ratio = cs.sum1(speeds) / (4 * HOVER_SPEED)
    thrust = cs.sum1(thrusts)

    flow = to_body(q, velocity - cs.DM(WIND))
    factor = thrust_factor(flow, -state[2])
    tilt = thrust * FLAPPING_TILT
    force = cs.vertcat(-tilt * flow[0], -tilt * flow[1], -thrust * factor)
    force -= (ratio * cs.DM(ROTOR_DRAG) + cs.DM(LINEAR_DRAG)) * flow
    if PARASITIC_DRAG > 0:
        force -= PARASITIC_DRAG * cs.sqrt(cs.dot(flow, flow) + 1e-12) * flow
    moment = cs.vertcat(
        -factor * cs.dot(cs.DM(ROTOR_Y), thrusts),
        factor * cs.dot(cs.DM(ROTOR_X), thrusts),
        cs.dot(cs.DM(TORQUE_PER_THRUST), thrusts),
    )
    flapping = ratio * FLAPPING_MOMENT
    moment += cs.vertcat(-flapping * flow[1], flapping * flow[0], 0)
    moment -= cs.DM(ANGULAR_DAMPING) * rate
    if any(SPIN_MOMENTUM):
        momentum = cs.dot(cs.DM(SPIN_MOMENTUM), speeds)
        change = cs.jtimes(momentum, rotors, rotors_dot) if LAG > 0 else 0
        moment += cs.vertcat(-rate[1] * momentum, rate[0] * momentum, -change)

    inertia = cs.DM(INERTIA)
    acceleration = to_world(q, force) / MASS + cs.DM([0, 0, GRAVITY])
    angular = (moment - cs.cross(rate, inertia * rate)) / inertia
    p, q_rate, r = rate[0], rate[1], rate[2]
    turn = 0.5 * cs.vertcat(
        -q[1] * p - q[2] * q_rate - q[3] * r,
        q[0] * p + q[2] * r - q[3] * q_rate,
        q[0] * q_rate + q[3] * p - q[1] * r,
        q[0] * r + q[1] * q_rate - q[2] * p,
    )
    slope = [velocity, acceleration, turn, angular] + ([rotors_dot] if LAG > 0 else [])
    return cs.Function(
        "vehicle",
        [state, outputs, voltage],
        [cs.vertcat(*slope)],
        ["state", "outputs", "voltage_v"],
        ["slope"],
    )

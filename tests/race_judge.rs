//! A judge of course flights that is independent of the planner: its own rigid body in its own axes
//! (x, y level, z up; body front, left, up), integrated from the rotor thrusts at 1 kHz.

/// The rigid body and its rotors.
#[derive(Clone, Copy, Debug)]
pub struct JudgedVehicle {
    /// kg
    pub mass: f64,
    /// kg m^2
    pub inertia: [f64; 3],
    /// m/s^2
    pub gravity: f64,
    /// Front and left of each rotor, m.
    pub arms: [[f64; 2]; 4],
    /// Moment about up by thrust, m.
    pub yaw: [f64; 4],
}

/// The limits.
#[derive(Clone, Copy, Debug)]
pub struct JudgedLimits {
    /// N, each rotor.
    pub thrust: [f64; 2],
    /// rad/s
    pub rate: [f64; 3],
}

/// A state: place, velocity, attitude body to world (w, x, y, z), body rate.
#[derive(Clone, Copy, Debug)]
pub struct JudgedState {
    /// s
    pub t: f64,
    pub place: [f64; 3],
    pub velocity: [f64; 3],
    pub attitude: [f64; 4],
    pub rate: [f64; 3],
}

/// Thrusts (N) that are held for a time (s).
#[derive(Clone, Copy, Debug)]
pub struct JudgedInput {
    pub thrusts: [f64; 4],
    pub held: f64,
}

/// The passages, in order.
#[derive(Clone, Copy, Debug)]
pub enum JudgedPassage {
    /// A ball.
    Ball { centre: [f64; 3], radius: f64 },
    /// A rectangle crossed along its normal: unit vectors and half sizes.
    Gate { centre: [f64; 3], normal: [f64; 3], side: [f64; 3], half: [f64; 2] },
}

/// The verdict.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// s
    pub duration: f64,
    /// Largest violation of the thrust limits, N.
    pub thrust_excess: f64,
    /// Largest violation of the rate limits, rad/s.
    pub rate_excess: f64,
    /// How far outside each passage the flight passes, in order, m; infinite for a gate that is not
    /// crossed.
    pub misses: Vec<f64>,
    /// Time of each passage, s.
    pub times: Vec<f64>,
    /// The last state.
    pub end: Option<JudgedState>,
}

impl Verdict {
    /// The largest miss, m.
    pub fn miss(&self) -> f64 {
        self.misses.iter().copied().fold(0.0, f64::max)
    }
}

type Slope = ([f64; 3], [f64; 3], [f64; 4], [f64; 3]);

fn rotate(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let [w, x, y, z] = q;
    [
        (1.0 - 2.0 * (y * y + z * z)) * v[0]
            + 2.0 * (x * y - w * z) * v[1]
            + 2.0 * (x * z + w * y) * v[2],
        2.0 * (x * y + w * z) * v[0]
            + (1.0 - 2.0 * (x * x + z * z)) * v[1]
            + 2.0 * (y * z - w * x) * v[2],
        2.0 * (x * z - w * y) * v[0]
            + 2.0 * (y * z + w * x) * v[1]
            + (1.0 - 2.0 * (x * x + y * y)) * v[2],
    ]
}

fn slope(vehicle: &JudgedVehicle, s: &JudgedState, f: [f64; 4]) -> Slope {
    let sum: f64 = f.iter().sum();
    let mut moment = [0.0; 3];
    for (f, ([front, left], yaw)) in f.iter().zip(vehicle.arms.iter().zip(&vehicle.yaw)) {
        moment[0] += left * f;
        moment[1] -= front * f;
        moment[2] += yaw * f;
    }
    let mut acceleration = rotate(s.attitude, [0.0, 0.0, sum / vehicle.mass]);
    acceleration[2] -= vehicle.gravity;
    let [p, q, r] = s.rate;
    let [jx, jy, jz] = vehicle.inertia;
    let angular = [
        (moment[0] + (jy - jz) * q * r) / jx,
        (moment[1] + (jz - jx) * r * p) / jy,
        (moment[2] + (jx - jy) * p * q) / jz,
    ];
    let [w, x, y, z] = s.attitude;
    let turn = [
        -0.5 * (x * p + y * q + z * r),
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
    ];
    (s.velocity, acceleration, turn, angular)
}

fn moved(s: &JudgedState, k: &Slope, h: f64) -> JudgedState {
    let mut next = *s;
    for i in 0..3 {
        next.place[i] += h * k.0[i];
        next.velocity[i] += h * k.1[i];
        next.rate[i] += h * k.3[i];
    }
    for i in 0..4 {
        next.attitude[i] += h * k.2[i];
    }
    next.t += h;
    next
}

/// One Runge-Kutta step.
pub fn step(vehicle: &JudgedVehicle, s: &JudgedState, f: [f64; 4], h: f64) -> JudgedState {
    let k1 = slope(vehicle, s, f);
    let k2 = slope(vehicle, &moved(s, &k1, 0.5 * h), f);
    let k3 = slope(vehicle, &moved(s, &k2, 0.5 * h), f);
    let k4 = slope(vehicle, &moved(s, &k3, h), f);
    let mut next = *s;
    for (k, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
        let t = next.t;
        next = moved(&next, &k, weight * h / 6.0);
        next.t = t;
    }
    next.t = s.t + h;
    let norm = next.attitude.iter().map(|c| c * c).sum::<f64>().sqrt();
    next.attitude = next.attitude.map(|c| c / norm);
    next
}

/// The states of a flight, a millisecond or less apart.
pub fn fly(
    vehicle: &JudgedVehicle,
    start: JudgedState,
    inputs: &[JudgedInput],
) -> Vec<JudgedState> {
    let mut states = vec![start];
    let mut state = start;
    for input in inputs {
        let steps = (input.held / 1e-3).ceil().max(1.0);
        for _ in 0..steps as usize {
            state = step(vehicle, &state, input.thrusts, input.held / steps);
            states.push(state);
        }
    }
    states
}

fn off(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Judges states in order of time, with the thrusts held between them.
pub fn judge(
    states: &[JudgedState],
    inputs: &[JudgedInput],
    limits: &JudgedLimits,
    passages: &[JudgedPassage],
) -> Verdict {
    let mut verdict = Verdict::default();
    for f in inputs.iter().flat_map(|input| input.thrusts) {
        let excess = (limits.thrust[0] - f).max(f - limits.thrust[1]);
        verdict.thrust_excess = verdict.thrust_excess.max(excess);
    }
    for state in states {
        for i in 0..3 {
            verdict.rate_excess = verdict.rate_excess.max(state.rate[i].abs() - limits.rate[i]);
        }
    }
    let mut from = 0;
    for passage in passages {
        let (at, miss) = match passage {
            JudgedPassage::Ball { centre, radius } => touch(states, from, *centre, *radius),
            JudgedPassage::Gate { centre, normal, side, half } => {
                crossing(states, from, *centre, [*normal, *side], *half)
            }
        };
        verdict.misses.push(miss);
        verdict.times.push(states[at].t);
        from = at;
    }
    verdict.duration = states.last().map_or(0.0, |s| s.t) - states.first().map_or(0.0, |s| s.t);
    verdict.end = states.last().copied();
    verdict
}

/// The nearest point of the first approach to within half a metre of the sphere, on the straight
/// segments between states.
fn touch(states: &[JudgedState], from: usize, centre: [f64; 3], radius: f64) -> (usize, f64) {
    let distance = |n: usize| {
        let a = off(states[n].place, centre);
        let way = states.get(n + 1).map_or([0.0; 3], |next| off(next.place, states[n].place));
        let share = (-dot(a, way) / dot(way, way).max(1e-12)).clamp(0.0, 1.0);
        let d: [f64; 3] = std::array::from_fn(|i| a[i] + share * way[i]);
        dot(d, d).sqrt() - radius
    };
    let near = (from..states.len()).find(|n| distance(*n) < 0.5).unwrap_or(from);
    let gone = (near..states.len()).find(|n| distance(*n) > 0.5).unwrap_or(states.len());
    // The first state inside the sphere: the next passage may lead back.
    if let Some(first) = (near..gone).find(|n| distance(*n) <= 0.0) {
        return (first, 0.0);
    }
    let nearest = (near..gone).min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    nearest.map_or((from, f64::INFINITY), |n| (n, distance(n)))
}

/// The first crossing of the gate's plane through its opening along the normal; without one, the
/// miss is infinite.
fn crossing(
    states: &[JudgedState],
    from: usize,
    centre: [f64; 3],
    [normal, side]: [[f64; 3]; 2],
    half: [f64; 2],
) -> (usize, f64) {
    let up = cross(normal, side);
    let mut best = (from, f64::INFINITY);
    for n in from.max(1)..states.len() {
        let (a, b) = (off(states[n - 1].place, centre), off(states[n].place, centre));
        let (before, after) = (dot(a, normal), dot(b, normal));
        if before <= 0.0 && after > 0.0 {
            let share = before / (before - after);
            let at: [f64; 3] = std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
            let miss = (dot(at, side).abs() - half[0]).max(dot(at, up).abs() - half[1]);
            if miss <= 1e-3 {
                return (n, miss);
            }
            if miss < best.1 {
                best = (n, miss);
            }
        }
    }
    best
}

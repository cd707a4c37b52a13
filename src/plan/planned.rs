//! A finished plan, as a file and as the reference of a flight.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::AttitudePd;
use vehicle::bounded;
use vehicle::frame::{Euler, Frd, Ned, wrap_angle};

use super::discretisation::commanded_wrench;
use super::flyable::{NotFlyable, check_led, check_violation};
use super::iterate::Violation;
use super::planned_tube::PlannedTube;
use super::problem::{ANGLE, RATE, StateVector, VELOCITY};
use super::reference::ReferenceSource;
use super::scp::{Outcome, Record, Status};
use crate::setpoint::{Expected, Reference, Setpoint};

/// Identifier in the file's `schema` field.
const SCHEMA: &str = "downwash.plan";
/// Version of the file format; files of other versions are rejected.
const VERSION: u32 = 2;
/// Longest plan that is accepted, in periods: three hours at 100 Hz.
const PERIODS_MAX: usize = 1_080_000;

/// Largest file, in bytes: room for that many periods.
const SIZE_MAX: u64 = 512 << 20;

/// A commanded input `u_hat = (u1, zeta_des, omega_des)` in N, rad and rad/s.
pub type CommandedInput = [f64; 7];

/// A plan: states, the inputs that connect them, and the record of the search. Position is relative
/// to the take-off point, as in the desired trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    schema: String,
    schema_version: u32,
    /// Name of the desired trajectory.
    pub trajectory: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The vehicle's parameters.
    pub body: PlannedBody,
    /// The model that it was planned through.
    pub model: PlannedThrough,
    /// Time between states, s.
    pub period_s: f64,
    /// The vehicle's response to its inputs, according to the model.
    pub answer: Answer,
    /// How the search ended.
    pub status: Status,
    /// Sum of the distances to the desired states; for a minimum-time plan, its length in s.
    pub cost: f64,
    /// The plan's violations.
    pub violation: Violation,
    /// The search's subproblems.
    pub records: Vec<Record>,
    /// The desired states, one more than inputs; in a minimum-time plan, the planned states.
    pub desired: Vec<StateVector>,
    /// The planned states, one more than inputs.
    pub states: Vec<StateVector>,
    /// The planned inputs.
    pub inputs: Vec<CommandedInput>,
    /// The tube around the plan, if it was planned with one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tube: Option<PlannedTube>,
}

/// The vehicle parameters that a plan's inputs hold for, with the modelled effects applied.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedBody {
    /// kg
    pub mass_kg: f64,
    /// Principal moments about body x, y, z, kg m^2.
    pub inertia: [f64; 3],
    /// m/s^2
    pub gravity: f64,
    /// Thrust of all rotors at full output, N.
    pub thrust_full_n: f64,
}

/// The model of a plan.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedThrough {
    /// net, physics or hybrid; nominal for the vehicle file's own physics.
    pub kind: String,
    /// SHA-256 of the model file, if there is one.
    pub sha256: Option<String>,
}

impl PlannedThrough {
    /// Kind of the model that is the vehicle file's own physics.
    const NOMINAL: &str = "nominal";

    /// The vehicle file's own physics.
    pub fn nominal() -> Self {
        Self { kind: Self::NOMINAL.to_owned(), sha256: None }
    }

    /// Whether this is the vehicle file's own physics.
    pub fn is_nominal(&self) -> bool {
        self.kind == Self::NOMINAL
    }
}

/// The vehicle's response to its inputs: the plan's inputs are those that act, and are sent
/// earlier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// Delay from sending a setpoint to its use on board, s.
    pub delay_s: f64,
    /// First-order lag from a commanded wrench to the acting one, s.
    pub lag_s: f64,
    /// Exponent of the thrust in the pack's voltage, relative to a full pack.
    pub voltage_exponent: f64,
    /// The loop that turns setpoints into moments.
    pub attitude_pd: AttitudePd,
}

/// Why a plan is rejected.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("plan {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// Not a plan, or a damaged one.
    #[error("plan {}: {reason}; plan it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// The parts of a new plan that the search does not provide.
#[derive(Clone, Debug)]
pub struct Found {
    /// Name of the desired trajectory.
    pub trajectory: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The vehicle's parameters.
    pub body: PlannedBody,
    /// The model that it was planned through.
    pub model: PlannedThrough,
    /// Time between states, s.
    pub period_s: f64,
    /// The vehicle's response.
    pub answer: Answer,
    /// The desired states, one more than inputs.
    pub desired: Vec<StateVector>,
}

impl Plan {
    /// The plan from a search's outcome.
    pub fn new(found: Found, outcome: Outcome<7>) -> Self {
        let Found { trajectory, vehicle, body, model, period_s, answer, desired } = found;
        Self {
            schema: SCHEMA.to_owned(),
            schema_version: VERSION,
            trajectory,
            vehicle,
            body,
            model,
            period_s,
            answer,
            status: outcome.status,
            cost: outcome.cost,
            violation: outcome.violation,
            records: outcome.records,
            desired,
            states: outcome.iterate.states,
            inputs: outcome.iterate.inputs,
            tube: None,
        }
    }

    /// Adds a tube to the plan.
    #[must_use]
    pub fn with_tube(self, tube: Option<PlannedTube>) -> Self {
        Self { tube, ..self }
    }

    /// Whether a file counts as a plan, by its name alone: no trajectory is JSON.
    pub fn is_plan(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension == "json")
    }

    /// Reads and checks a plan.
    ///
    /// # Errors
    /// [`PlanError`] if the file is not a plan, has another version, or holds invalid numbers.
    pub fn load(path: &Path) -> Result<Self, PlanError> {
        let text = bounded::read_to_string(path, SIZE_MAX)
            .map_err(|source| PlanError::Io { path: path.to_owned(), source })?;
        Self::parse(&text, path)
    }

    /// Parses the content of a plan file; `origin` names it in errors.
    ///
    /// # Errors
    /// As [`Plan::load`], except that nothing is read.
    pub fn parse(text: &str, origin: &Path) -> Result<Self, PlanError> {
        let damaged = |reason: String| PlanError::Damaged { path: origin.to_owned(), reason };
        let plan: Self = serde_json::from_str(text).map_err(|error| damaged(error.to_string()))?;
        plan.check().map_err(damaged)?;
        Ok(plan)
    }

    /// The content of its file.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string(self)
    }

    fn check(&self) -> Result<(), String> {
        if self.schema != SCHEMA || self.schema_version != VERSION {
            return Err(format!(
                "expected schema {SCHEMA} of version {VERSION}, found {} of version {}",
                self.schema, self.schema_version
            ));
        }
        if self.inputs.is_empty() || self.inputs.len() > PERIODS_MAX {
            return Err(format!(
                "expected 1 to {PERIODS_MAX} periods, found {}",
                self.inputs.len()
            ));
        }
        let states = self.inputs.len() + 1;
        if self.states.len() != states || self.desired.len() != states {
            return Err(format!(
                "expected {states} states and desired states, found {} and {}",
                self.states.len(),
                self.desired.len()
            ));
        }
        let Answer { delay_s, lag_s, voltage_exponent, attitude_pd } = self.answer;
        if !(0.0..=4.0).contains(&voltage_exponent) {
            return Err(format!("expected a voltage_exponent of 0 to 4, found {voltage_exponent}"));
        }
        let times = [self.period_s, delay_s, lag_s];
        if !(self.period_s > 0.0 && times.iter().all(|t| (0.0..=10.0).contains(t))) {
            return Err(format!("expected times of 0 to 10 s, found {times:?}"));
        }
        // The setpoints divide moments by them.
        if !attitude_pd.kp.iter().all(|kp| *kp > 0.0) {
            return Err(format!("expected attitude gains kp above 0, found {:?}", attitude_pd.kp));
        }
        let gains = attitude_pd.kp.iter().chain(&attitude_pd.kd);
        let numbers = self.states.iter().flatten().chain(self.inputs.iter().flatten());
        if !numbers.chain(gains).all(|number| number.is_finite()) {
            return Err("a number is not finite".to_owned());
        }
        self.tube.as_ref().map_or(Ok(()), |tube| tube.check(states))
    }

    /// Whether this is a minimum-time plan: its desired states are the planned ones.
    pub fn is_fastest(&self) -> bool {
        self.states == self.desired
    }

    /// Distance between the planned and the desired position after each period, m.
    pub fn distances(&self) -> Vec<f64> {
        let pairs = self.states.iter().zip(&self.desired).skip(1);
        pairs
            .map(|(state, desired)| {
                (0..3).map(|i| (state[i] - desired[i]).powi(2)).sum::<f64>().sqrt()
            })
            .collect()
    }

    /// Whether the plan may be flown, at its states and between them: a failed search, or one that
    /// ended with states that no input connects, gives no such plan. Independently of the model, it
    /// also checks that velocity and body rate lead from state to state.
    ///
    /// # Errors
    /// What it violates, in words.
    pub fn check_flyable(&self) -> Result<(), NotFlyable> {
        check_violation(self.status, &self.violation)?;
        check_led(&self.states, self.period_s)
    }

    /// Length in s.
    pub fn duration(&self) -> f64 {
        self.inputs.len() as f64 * self.period_s
    }
}

/// A plan as the reference of a flight.
#[derive(Clone, Debug)]
pub struct PlannedReference {
    period_s: f64,
    states: Vec<StateVector>,
    /// The inputs with the inverse of the lag applied, each at the state that it acts from.
    led: Vec<CommandedInput>,
    delay_s: f64,
    /// What the plan's model expects beyond weight, thrust and the attitude loop from each state to
    /// the next: acceleration, and attitude.
    expected: Vec<[f64; 6]>,
    start_thrust_n: f64,
    voltage_exponent: f64,
    /// The tube's radius at each state, m; empty without a tube.
    tube_radius_m: Vec<[f64; 1]>,
}

/// Periods whose mean thrust is the thrust at the start.
const STILL_PERIODS: usize = 20;
/// Periods on either side of a slope. Neighbours alone would amplify the small jumps between the
/// inputs of plans through networks by the lag over the period.
const SLOPE_PERIODS: usize = 3;

/// Slopes per row of the least-squares lines through the rows around `n`.
fn slope_around<const N: usize>(rows: &[[f64; N]], n: usize) -> [f64; N] {
    let from = n.saturating_sub(SLOPE_PERIODS);
    let around = &rows[from..rows.len().min(n + SLOPE_PERIODS + 1)];
    let middle = 0.5 * (around.len() as f64 - 1.0);
    let (mut sums, mut squares) = ([0.0; N], 0.0);
    for (k, row) in around.iter().enumerate() {
        let from_middle = k as f64 - middle;
        squares += from_middle * from_middle;
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += from_middle * value;
        }
    }
    sums.map(|sum| if squares > 0.0 { sum / squares } else { 0.0 })
}

impl PlannedBody {
    /// What leads a body from one of a plan's states to the next beyond weight, thrust and the
    /// moments of `pd`: acceleration (m/s^2), and the residual moments as the attitude (rad) from
    /// which `pd` produces them.
    fn expected(
        &self,
        pair: &[StateVector],
        input: &CommandedInput,
        period: f64,
        pd: &AttitudePd,
    ) -> [f64; 6] {
        let [before, after] = pair else { return [0.0; 6] };
        let slope = |i: usize| (after[i] - before[i]) / period;
        let [_, _, _, _, _, _, roll, pitch, yaw, p, q, r] = *before;
        let axis = Euler::new(roll, pitch, yaw).attitude().to_world(Frd::new(0.0, 0.0, 1.0));
        let carried = axis * (-input[0] / self.mass_kg) + Ned::new(0.0, 0.0, self.gravity);
        let carried = carried.to_array();
        let momentum = Frd::new(p, q, r).scale_by(self.inertia);
        let gyroscopic = Frd::new(p, q, r).cross(momentum).to_array();
        std::array::from_fn(|i| match i.checked_sub(3) {
            None => slope(VELOCITY + i) - carried[i],
            Some(i) => {
                let moment = pd.kp[i] * wrap_angle(input[1 + i] - before[ANGLE + i])
                    + pd.kd[i] * (input[4 + i] - before[RATE + i]);
                (self.inertia[i] * slope(RATE + i) + gyroscopic[i] - moment) / pd.kp[i]
            }
        })
    }
}

impl PlannedReference {
    /// The plan with its inputs as they must be sent.
    ///
    /// A wrench acts `delay_s` after its setpoint is sent and through a lag of `lag_s`. The
    /// setpoint sent at t is therefore the input at `t + delay_s` with the inverse of the lag
    /// applied: the loop's moments M become `M* + lag dM*/dt`, which takes a shift of the attitude
    /// setpoint by `lag Kp^-1 dM*/dt`, and thrust likewise.
    pub fn new(plan: &Plan) -> Self {
        let radii = plan.tube.iter().flat_map(|tube| &tube.radius_m);
        Self {
            tube_radius_m: radii.map(|radius| [*radius]).collect(),
            ..Self::of(&plan.states, &plan.inputs, plan.period_s, &plan.answer, &plan.body)
        }
    }

    /// The same from states and inputs, `period` seconds apart.
    pub(super) fn of(
        states: &[StateVector],
        inputs: &[CommandedInput],
        period: f64,
        answer: &Answer,
        body: &PlannedBody,
    ) -> Self {
        let Answer { delay_s, lag_s, voltage_exponent, attitude_pd } = *answer;
        let wrenches: Vec<[f64; 4]> = inputs
            .iter()
            .zip(states)
            .map(|(input, state)| commanded_wrench(&attitude_pd, state, input))
            .collect();
        let led: Vec<CommandedInput> = inputs
            .iter()
            .enumerate()
            .map(|(n, input)| {
                let slope = slope_around(&wrenches, n).map(|slope| slope / period);
                let mut sent = *input;
                sent[0] += lag_s * slope[0];
                for i in 0..3 {
                    sent[1 + i] += lag_s * slope[1 + i] / attitude_pd.kp[i];
                }
                sent
            })
            .collect();
        let steps = states.windows(2).zip(inputs);
        let expected =
            steps.map(|(pair, input)| body.expected(pair, input, period, &attitude_pd)).collect();
        let first = &inputs[..inputs.len().min(STILL_PERIODS)];
        let start_thrust_n = first.iter().map(|input| input[0]).sum::<f64>() / first.len() as f64;
        Self {
            period_s: period,
            states: states.to_vec(),
            led,
            delay_s,
            expected,
            start_thrust_n,
            voltage_exponent,
            tube_radius_m: Vec::new(),
        }
    }
}

impl PlannedReference {
    /// The setpoint sent at `t` seconds, which acts after the delay. A plan's first inputs are sent
    /// before it begins.
    pub(super) fn sent(&self, t: f64) -> Setpoint {
        let [thrust_n, roll, pitch, yaw, p, q, r] =
            between(&self.led, (t + self.delay_s) / self.period_s);
        Setpoint {
            thrust_n,
            attitude: Euler::new(roll, pitch, wrap_angle(yaw)),
            body_rate: Frd::new(p, q, r),
        }
    }
}

/// A row at a fractional index, interpolated, held at both ends.
fn between<const N: usize>(rows: &[[f64; N]], index: f64) -> [f64; N] {
    let last = rows.len() - 1;
    let index = index.clamp(0.0, last as f64);
    let (before, share) = (index.floor() as usize, index.fract());
    let after = (before + 1).min(last);
    std::array::from_fn(|i| rows[before][i] + share * (rows[after][i] - rows[before][i]))
}

impl ReferenceSource for PlannedReference {
    fn duration(&self) -> f64 {
        (self.states.len() - 1) as f64 * self.period_s
    }

    fn expected(&self, t: f64) -> Option<Expected> {
        let [north, east, down, attitude @ ..] = between(&self.expected, t / self.period_s);
        Some(Expected { acceleration: Ned::new(north, east, down), attitude })
    }

    fn tube_radius_m(&self, t: f64) -> Option<f64> {
        let index = t / self.period_s;
        (!self.tube_radius_m.is_empty()).then(|| between(&self.tube_radius_m, index)[0])
    }

    fn start_thrust_n(&self) -> f64 {
        self.start_thrust_n
    }

    fn voltage_exponent(&self) -> f64 {
        self.voltage_exponent
    }

    fn sample(&self, t: f64) -> Reference {
        let index = t / self.period_s;
        let [n, e, d, vn, ve, vd, roll, pitch, yaw, p, q, r] = between(&self.states, index);
        Reference {
            position: Ned::new(n, e, d),
            velocity: Ned::new(vn, ve, vd),
            attitude: Euler::new(roll, pitch, wrap_angle(yaw)),
            body_rate: Frd::new(p, q, r),
            // Held before the start and after the end.
            feedforward: self.sent(t.clamp(0.0, self.duration())),
        }
    }
}

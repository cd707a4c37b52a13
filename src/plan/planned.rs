//! A plan that was found, as a file, and as the reference that a flight follows.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sitl::frame::{Euler, Frd, Ned, wrap_angle};
use sitl::vehicle::AttitudePd;

use super::discretisation::coasted;
use super::iterate::{Violation, entry_once_out};
use super::keep_out::KeepOut;
use super::problem::{ANGLE, RATE, StateVector};
use super::reference::ReferenceSource;
use super::scp::{Outcome, Record, Status};
use crate::setpoint::{Reference, Setpoint};

/// What the file says that it is.
const SCHEMA: &str = "downwash.plan";
/// Version of the file's form; files of others are refused.
const VERSION: u32 = 2;
/// Longest plan that is read, in periods: three hours at 100 Hz.
const PERIODS_MAX: usize = 1_080_000;

/// A commanded input `u_hat = (u1, zeta_des, omega_des)` in N, rad and rad/s.
pub type CommandedInput = [f64; 7];

/// A plan: states, the inputs that lead through them, and how they were found. Position is relative
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
    /// The vehicle's numbers.
    pub body: PlannedBody,
    /// What it was planned through.
    pub model: PlannedThrough,
    /// Time between states, s.
    pub period_s: f64,
    /// How the vehicle answers its inputs, as the model has it.
    pub answer: Answer,
    /// How the search ended.
    pub status: Status,
    /// Sum of the distances to the desired states.
    pub cost: f64,
    /// What the plan misses.
    pub violation: Violation,
    /// The search's subproblems.
    pub records: Vec<Record>,
    /// The desired states, one more than inputs.
    pub desired: Vec<StateVector>,
    /// The planned states, one more than inputs.
    pub states: Vec<StateVector>,
    /// The planned inputs.
    pub inputs: Vec<CommandedInput>,
}

/// What of its vehicle a plan's inputs hold for, the modelled effects applied.
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedThrough {
    /// net, physics or hybrid; nominal for the vehicle file's own physics.
    pub kind: String,
    /// SHA-256 of the model file, where there is one.
    pub sha256: Option<String>,
}

/// How the vehicle answers its inputs: the plan's inputs are those that act, and are sent early.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// From a setpoint's sending to its use on board, s.
    pub delay_s: f64,
    /// First-order lag from a commanded wrench to the one that acts, s.
    pub lag_s: f64,
    /// Power of the pack's voltage, over that of a full one, that thrust goes with.
    pub voltage_exponent: f64,
    /// The loop that turns setpoints into moments.
    pub attitude_pd: AttitudePd,
}

/// Why a plan is refused.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("plan {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
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

/// Largest defect and overrun of a plan that is flown.
const DEFECT_MAX: f64 = 1e-4;
const OVERRUN_MAX: f64 = 1e-2;
/// How far a position may be where it must not be, m.
const TRESPASS_MAX_M: f64 = 1e-3;

/// Why a plan is not flown.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotFlyable {
    /// Its search found nothing.
    #[error("the search of this plan failed; change the trajectory or [plan] in the configuration")]
    Failed,
    /// It breaks the dynamics or a bound.
    #[error(
        "the plan misses its dynamics by {defect:.1e} (at most {DEFECT_MAX:.0e}) and its bounds by \
         {overrun:.1e} (at most {OVERRUN_MAX:.0e}); change the trajectory, or [plan] in the \
         configuration"
    )]
    Violated {
        /// Largest defect of the dynamics.
        defect: f64,
        /// Largest overrun of a state's bounds (m, rad, rad/s).
        overrun: f64,
    },
    /// It leads where the vehicle must not be.
    #[error(
        "the plan leads {trespass_m:.4} m into a region to keep out of, or out of the box to stay in \
         (at most {TRESPASS_MAX_M} m): change the trajectory, or [plan] in the configuration"
    )]
    Trespass {
        /// How far at most, m.
        trespass_m: f64,
    },
    /// Its states do not follow from one another.
    #[error(
        "the plan's position or attitude jumps by {jump:.1e} m or rad at {at_s:.2} s, where its \
         velocity or body rate does not lead (at most {DEFECT_MAX:.0e}): the file was changed; plan \
         it again"
    )]
    Torn {
        /// The jump that was found first, m or rad.
        jump: f64,
        /// Where, s.
        at_s: f64,
    },
}

/// As [`Plan::check_flyable`], of what a search says.
fn check_violation(status: Status, violation: &Violation) -> Result<(), NotFlyable> {
    let Violation { defect, overrun, trespass_m } = *violation;
    if status == Status::Failed {
        return Err(NotFlyable::Failed);
    }
    if !(defect <= DEFECT_MAX && overrun <= OVERRUN_MAX) {
        return Err(NotFlyable::Violated { defect, overrun });
    }
    if trespass_m.is_nan() || trespass_m > TRESPASS_MAX_M {
        return Err(NotFlyable::Trespass { trespass_m });
    }
    Ok(())
}

/// As [`Plan::check_flyable`], for a plan that begins where a flying vehicle is. That may be a
/// little inside of a region to keep out of, or out of the box to stay in, and the vehicle must
/// not be left without a plan there: each region counts from where the plan is out of it, and the
/// box as any other bound.
pub(super) fn check_in_flight(
    outcome: &Outcome<7>,
    regions: impl Iterator<Item = KeepOut>,
) -> Result<(), NotFlyable> {
    let states = &outcome.iterate.states;
    let entries = regions.map(|region| entry_once_out(states, &region, TRESPASS_MAX_M));
    let trespass_m = entries.fold(0.0, f64::max);
    check_violation(outcome.status, &Violation { trespass_m, ..outcome.violation })
}

/// What a new plan is made of.
#[derive(Clone, Debug)]
pub struct Found {
    /// Name of the desired trajectory.
    pub trajectory: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The vehicle's numbers.
    pub body: PlannedBody,
    /// What it was planned through.
    pub model: PlannedThrough,
    /// Time between states, s.
    pub period_s: f64,
    /// How the vehicle answers.
    pub answer: Answer,
    /// The desired states, one more than inputs.
    pub desired: Vec<StateVector>,
}

impl Plan {
    /// The plan of a search's outcome.
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
        }
    }

    /// Whether a file's beginning is that of a plan.
    pub fn is_plan(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension == "json")
    }

    /// Reads a plan.
    ///
    /// # Errors
    /// [`PlanError`] where the file is none, of another version, or holds numbers that no plan
    /// has.
    pub fn load(path: &Path) -> Result<Self, PlanError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| PlanError::Io { path: path.to_owned(), source })?;
        let damaged = |reason: String| PlanError::Damaged { path: path.to_owned(), reason };
        let plan: Self = serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        plan.check().map_err(damaged)?;
        Ok(plan)
    }

    /// The text of its file.
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
        let gains = attitude_pd.kp.iter().chain(&attitude_pd.kd);
        let numbers = self.states.iter().flatten().chain(self.inputs.iter().flatten());
        if !numbers.chain(gains).all(|number| number.is_finite()) {
            return Err("a number is not finite".to_owned());
        }
        Ok(())
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

    /// Whether the plan holds what it says, between its states as at them: a search that failed,
    /// or that ended with states that no input leads through, is no plan to fly. What the model
    /// has no part in, that velocity and body rate lead from state to state, is looked at again.
    ///
    /// # Errors
    /// What it misses, in words.
    pub fn check_flyable(&self) -> Result<(), NotFlyable> {
        check_violation(self.status, &self.violation)?;
        for (n, pair) in self.states.windows(2).enumerate() {
            let [state, next] = pair else { continue };
            let led = coasted(state, self.period_s);
            let kinematic = (0..3).chain(ANGLE..RATE);
            let mut jumps = kinematic.map(|i| (next[i] - led[i]).abs());
            if let Some(jump) = jumps.find(|jump| jump.is_nan() || *jump > DEFECT_MAX) {
                return Err(NotFlyable::Torn { jump, at_s: n as f64 * self.period_s });
            }
        }
        Ok(())
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
    /// As they are sent, one for each state.
    setpoints: Vec<CommandedInput>,
    start_thrust_n: f64,
    voltage_exponent: f64,
}

/// Periods whose mean thrust is taken for that of the start.
const STILL_PERIODS: usize = 20;
/// Periods on either side that a slope is taken over. One of neighbours alone would multiply the
/// small jumps between the inputs of plans through networks by the lag over the period.
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

impl PlannedReference {
    /// The plan with its inputs as they must be sent.
    ///
    /// A wrench acts `delay_s` after its setpoint is sent and through a lag of `lag_s`, so what is
    /// sent at t is the input of `t + delay_s` with the lag's inverse put before it: the loop's
    /// moments M are to be `M* + lag dM*/dt`, which the attitude setpoint asks for by
    /// `lag Kp^-1 dM*/dt`, and thrust likewise.
    pub fn new(plan: &Plan) -> Self {
        Self::of(&plan.states, &plan.inputs, plan.period_s, &plan.answer)
    }

    /// The same for states and inputs, `period` seconds apart.
    pub(super) fn of(
        states: &[StateVector],
        inputs: &[CommandedInput],
        period: f64,
        answer: &Answer,
    ) -> Self {
        let Answer { delay_s, lag_s, voltage_exponent, attitude_pd } = *answer;
        let AttitudePd { kp, kd, .. } = attitude_pd;
        let wrenches: Vec<[f64; 4]> = inputs
            .iter()
            .zip(states)
            .map(|(input, state)| {
                let moment = |i: usize| {
                    kp[i] * (input[1 + i] - state[ANGLE + i])
                        + kd[i] * (input[4 + i] - state[RATE + i])
                };
                [input[0], moment(0), moment(1), moment(2)]
            })
            .collect();
        let led: Vec<CommandedInput> = inputs
            .iter()
            .enumerate()
            .map(|(n, input)| {
                let slope = slope_around(&wrenches, n).map(|slope| slope / period);
                let mut sent = *input;
                sent[0] += lag_s * slope[0];
                for i in 0..3 {
                    sent[1 + i] += lag_s * slope[1 + i] / kp[i];
                }
                sent
            })
            .collect();
        let setpoints =
            (0..states.len()).map(|n| between(&led, n as f64 + delay_s / period)).collect();
        let first = &inputs[..inputs.len().min(STILL_PERIODS)];
        let start_thrust_n = first.iter().map(|input| input[0]).sum::<f64>() / first.len() as f64;
        Self {
            period_s: period,
            states: states.to_vec(),
            setpoints,
            start_thrust_n,
            voltage_exponent,
        }
    }
}

/// A row at a fractional index, held at both ends.
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

    fn start_thrust_n(&self) -> f64 {
        self.start_thrust_n
    }

    fn voltage_exponent(&self) -> f64 {
        self.voltage_exponent
    }

    fn sample(&self, t: f64) -> Reference {
        let index = t / self.period_s;
        let [n, e, d, vn, ve, vd, roll, pitch, yaw, p, q, r] = between(&self.states, index);
        let [thrust_n, roll_des, pitch_des, yaw_des, p_des, q_des, r_des] =
            between(&self.setpoints, index);
        Reference {
            position: Ned::new(n, e, d),
            velocity: Ned::new(vn, ve, vd),
            attitude: Euler::new(roll, pitch, wrap_angle(yaw)),
            body_rate: Frd::new(p, q, r),
            feedforward: Setpoint {
                thrust_n,
                attitude: Euler::new(roll_des, pitch_des, wrap_angle(yaw_des)),
                body_rate: Frd::new(p_des, q_des, r_des),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::iterate::Iterate;
    use crate::plan::problem::STATES;

    /// An outcome whose states are at these places north, m.
    fn outcome(north: &[f64], violation: Violation) -> Outcome<7> {
        let state = |north: &f64| {
            let mut state = [0.0; STATES];
            state[0] = *north;
            state
        };
        let states: Vec<StateVector> = north.iter().map(state).collect();
        let inputs = vec![[0.0; 7]; states.len() - 1];
        let iterate = Iterate { states, inputs };
        let status = Status::Converged;
        Outcome { status, iterate, cost: 0.0, violation, records: Vec::new() }
    }

    #[test]
    fn in_flight_a_region_counts_once_the_plan_is_out_of_it() {
        let regions = [
            KeepOut::Sphere { centre: Ned::new(1.0, 0.0, 0.0), radius: 0.1 },
            // Thinner than a step is long.
            KeepOut::Box { lower: Ned::new(-1.0, -1.0, -1.0), upper: Ned::new(-0.99, 1.0, 1.0) },
        ];
        let check = |north: &[f64]| {
            let violation = Violation { trespass_m: 0.006, ..Violation::default() };
            check_in_flight(&outcome(north, violation), regions.into_iter())
        };
        assert_eq!(check(&[0.0, 0.5, 0.9, 0.9005]), Ok(()));
        assert!(matches!(check(&[0.0, 0.5, 0.905]), Err(NotFlyable::Trespass { trespass_m })
            if (trespass_m - 0.005).abs() < 1e-12));
        assert!(matches!(check(&[-0.9, -1.1]), Err(NotFlyable::Trespass { .. })));
        // It begins inside, and is led out; then not back.
        assert_eq!(check(&[0.906, 0.904, 0.901, 0.89, 0.5]), Ok(()));
        assert!(check(&[0.906, 0.904, 0.9005, 0.905]).is_err());
    }

    #[test]
    fn in_flight_the_box_is_a_bound_as_any_other() {
        let check = |overrun| {
            let violation = Violation { overrun, trespass_m: overrun, ..Violation::default() };
            check_in_flight(&outcome(&[0.0, 1.0], violation), std::iter::empty())
        };
        assert_eq!(check(0.009), Ok(()));
        assert!(matches!(check(0.011), Err(NotFlyable::Violated { .. })));
        let violation = Violation { trespass_m: 0.009, ..Violation::default() };
        assert!(matches!(
            check_violation(Status::Converged, &violation),
            Err(NotFlyable::Trespass { .. })
        ));
    }
}

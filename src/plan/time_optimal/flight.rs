//! The minimum-time path as a plan that a flight follows.

use vehicle::AttitudePd;
use vehicle::frame::wrap_angle;
use vehicle::physics::Physics;
use vehicle::rigid_body::State;

use super::course::{Course, Limits, Margin};
use super::knots::{Knots, Period};
use super::planner::{Settings, Stop, TimeOptimal, plan};
use super::rotor_dynamics::RotorDynamics;
use super::task::{NoWay, Task};
use crate::control;
use crate::plan::feasibility::FlightEnvelope;
use crate::plan::iterate::Iterate;
use crate::plan::planner::PlanSettings;
use crate::plan::scp::Outcome;
use crate::plan::state_vector::{ANGLE, RATE, StateVector};

/// Largest tilt of a plan with roll, pitch and yaw as attitude, rad.
const TILT_MAX_RAD: f64 = 1.4;
/// Fraction of the envelope in use; the rest covers rounding to the plan's periods.
const ENVELOPE_SHARE: f64 = 0.99;
/// Typical sizes of attitude and rate errors: they divide a moment between the loop's two terms.
const ANGLE_SIZE: f64 = 0.3;
const RATE_SIZE: f64 = 3.0;
/// Largest step of the integration, s.
const STEP_S: f64 = 1e-3;

/// Everything that a flight's plan depends on.
#[derive(Clone, Debug)]
pub struct FlightPlanner {
    /// The vehicle's physics.
    pub physics: Physics,
    /// The attitude loop that takes the plan's inputs.
    pub attitude_pd: AttitudePd,
    /// Time constant of the rotors, s; the least time for which thrusts are held.
    pub lag_s: f64,
    /// The limits of setpoints, `[offboard.limits]`.
    pub limits: control::Limits,
    /// The limits of the flight, `[envelope]`.
    pub envelope: FlightEnvelope,
    /// Rate of the states, regions to avoid and box.
    pub settings: PlanSettings,
}

impl FlightPlanner {
    /// The limits that apply to a task: the narrowest of its own, those of setpoints and the
    /// envelope's, less a margin.
    pub fn limits(&self, task: &Task, margin: &Margin) -> Limits {
        let setpoint = &self.limits;
        let full = self.physics.allocation().collective_max();
        let hover = self.physics.body().mass() * self.physics.body().gravity() / full;
        let [least, most] = task.wishes.rotor.unwrap_or([0.0, 1.0]);
        let rate = [setpoint.body_rate_max_rad_s; 3];
        let wished = task.wishes.body_rate_rad_s.unwrap_or(rate);
        let envelope = &self.envelope;
        let tilt = [setpoint.tilt_max_rad, envelope.tilt_max_deg.to_radians(), TILT_MAX_RAD];
        let most = most.min(setpoint.thrust_max);
        let limits = Limits {
            rotor: [least.max(setpoint.thrust_min), most],
            body_rate_rad_s: std::array::from_fn(|i| rate[i].min(wished[i])),
            yaw_rate_rad_s: Some(ENVELOPE_SHARE * envelope.yaw_rate_max_deg_s.to_radians()),
            tilt_rad: Some(tilt.into_iter().chain(task.wishes.tilt_rad).fold(f64::MAX, f64::min)),
            speed_m_s: Some(
                (ENVELOPE_SHARE * envelope.speed_max_m_s)
                    .min(task.wishes.speed_m_s.unwrap_or(f64::MAX)),
            ),
        };
        let mut limits = limits.less(margin);
        // Each rotor gets at most its share of the total that the envelope allows.
        limits.rotor[1] = limits.rotor[1].min(ENVELOPE_SHARE * envelope.thrust_max_g * hover);
        limits
    }

    /// Plans a task.
    ///
    /// # Errors
    /// No path can lead through the course.
    pub fn plan(&self, task: &Task, margin: &Margin, stop: Stop<'_>) -> Result<FlightPlan, NoWay> {
        let keep_out = self.settings.keep_out.iter().map(|region| (*region).into()).collect();
        let room = self.settings.room();
        let course = task.course(keep_out, room)?;
        let limits = self.limits(task, margin);
        let defaults = Settings::default();
        let settings = Settings { length_min_s: defaults.length_min_s.max(self.lag_s), ..defaults };
        let found = plan(&course, &self.physics, &limits, &settings, stop);
        let outcome = self.outcome(&course, &found);
        Ok(FlightPlan { found, outcome })
    }

    /// The motion at the plan's rate, with the inputs of the on-board loop that produce it.
    fn outcome(&self, course: &Course, found: &TimeOptimal) -> Outcome<7> {
        let period_s = 1.0 / self.settings.rate_hz;
        let dynamics = RotorDynamics::new(self.physics.clone(), STEP_S);
        let mut states: Vec<StateVector> = Vec::new();
        let mut inputs = Vec::new();
        let mut replay = Replay::new(&found.knots, &dynamics);
        let mut yaw = course.start.yaw;
        loop {
            let state = vector(&replay.state, &mut yaw);
            states.push(state);
            if replay.is_over() {
                break;
            }
            let rotors = replay.advance(period_s);
            let wrench = self.physics.allocation().wrench(rotors);
            inputs.push(self.input(&state, &wrench));
        }
        Outcome {
            status: found.status,
            iterate: Iterate { states, inputs },
            cost: found.knots.duration_s(),
            violation: found.violation,
            records: found.records.clone(),
        }
    }

    /// The input `u_hat` at which the loop produces a wrench at a state: the smallest offset from
    /// the state's own attitude and rate.
    fn input(&self, state: &StateVector, wrench: &[f64; 4]) -> [f64; 7] {
        let AttitudePd { kp, kd, .. } = self.attitude_pd;
        let mut input = [wrench[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for (i, (kp, kd)) in kp.into_iter().zip(kd).enumerate() {
            let (angle, rate) = (kp * ANGLE_SIZE, kd * RATE_SIZE);
            let share = wrench[1 + i] / (angle * angle + rate * rate);
            input[1 + i] = state[ANGLE + i] + share * angle * ANGLE_SIZE;
            input[4 + i] = state[RATE + i] + share * rate * RATE_SIZE;
        }
        input
    }
}

/// A plan for a flight.
#[derive(Clone, Debug)]
pub struct FlightPlan {
    /// The minimum-time motion.
    pub found: TimeOptimal,
    /// The same motion at the plan's rate.
    pub outcome: Outcome<7>,
}

/// Replay of the motion over time. After its end, hover thrusts hold the vehicle.
struct Replay<'a> {
    knots: &'a Knots,
    dynamics: &'a RotorDynamics,
    state: State,
    period: usize,
    /// Rest of the period, s.
    left_s: f64,
}

impl<'a> Replay<'a> {
    fn new(knots: &'a Knots, dynamics: &'a RotorDynamics) -> Self {
        let left_s = knots.periods.first().map_or(0.0, |period| period.length_s);
        Self { knots, dynamics, state: knots.states[0], period: 0, left_s }
    }

    fn is_over(&self) -> bool {
        self.period >= self.knots.periods.len()
    }

    /// Advances by `length_s`; returns the mean thrust shares.
    fn advance(&mut self, length_s: f64) -> [f64; 4] {
        let mut sums = [0.0; 4];
        let mut open = length_s;
        while open > 1e-12 {
            let (rotors, share_s) = match self.knots.periods.get(self.period) {
                Some(period) => (period.rotors, self.left_s.min(open)),
                None => (self.hovering(), open),
            };
            self.state = self.dynamics.end(&self.state, &Period { rotors, length_s: share_s });
            for (sum, rotor) in sums.iter_mut().zip(rotors) {
                *sum += rotor * share_s / length_s;
            }
            open -= share_s;
            self.left_s -= share_s;
            if self.left_s <= 1e-12 && !self.is_over() {
                self.period += 1;
                self.left_s =
                    self.knots.periods.get(self.period).map_or(0.0, |period| period.length_s);
            }
        }
        sums
    }

    fn hovering(&self) -> [f64; 4] {
        let body = self.dynamics.physics().body();
        let weight = [body.mass() * body.gravity(), 0.0, 0.0, 0.0];
        self.dynamics.physics().allocation().outputs(weight)
    }
}

/// The state with a yaw that continues from `yaw`.
fn vector(state: &State, yaw: &mut f64) -> StateVector {
    let euler = state.attitude.euler();
    *yaw += wrap_angle(euler.yaw - *yaw);
    let [n, e, d] = state.position.to_array();
    let [vn, ve, vd] = state.velocity.to_array();
    let [p, q, r] = state.body_rate.to_array();
    [n, e, d, vn, ve, vd, euler.roll, euler.pitch, *yaw, p, q, r]
}

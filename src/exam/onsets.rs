//! Cases for the search for change points: flights with a change at one instant, and flights
//! without, of vehicles that differ from their files within builders' tolerances.

use sitl::config::{Autopilot, SitlConfig};
use vehicle::effects::{EffectError, EffectSet, Schedule};
use vehicle::frame::{Frd, Ned};
use vehicle::physics::Physics;
use vehicle::rigid_body::State;
use vehicle::rotor::Lag;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::draw::{Draw, rounded};
use crate::onset::columns::Cause;

/// Least strength of a change that should be found.
pub const DETECTABLE: f64 = 3.0;
/// Time after a change over which its strength is measured, s.
const OVER_S: f64 = 5.0;
/// Time before a change over which the noise is measured, s.
const NOISE_S: f64 = 10.0;
/// Horizon of predictions, s.
const HORIZON_S: f64 = 1.0;
/// Time between predictions, and the step of each, s.
const SPACING_S: f64 = 0.25;
const STEP_S: f64 = 0.01;
/// Length of a flight with a change, and the range of its time, s.
const FLIGHT_S: f64 = 60.0;
const AT_S: [f64; 2] = [32.0, 48.0];
/// Length of a flight without a change, s.
const NULL_S: f64 = 600.0;
/// Range of directions, rad: almost a full circle.
#[allow(clippy::approx_constant)] // the end of a range
const ANGLES: [f64; 2] = [0.0, 6.28];
/// Capacity of a pack that lasts, mAh.
const CAPACITY_MAH: f64 = 1e5;

/// A drawn change.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The cause that changes.
    pub cause: Cause,
    /// The change in the syntax of `--effect`.
    pub effect: String,
    /// Time of the change on the vehicle's clock, s.
    pub at_s: f64,
}

/// A drawn flight.
#[derive(Clone, Debug)]
pub struct OnsetCase {
    /// Name of a shipped vehicle.
    pub vehicle: &'static str,
    /// The autopilot that the vehicle emulates.
    pub autopilot: Autopilot,
    /// Contents of its trajectory file.
    pub trajectory: String,
    /// Differences of the vehicle from its file throughout, in the syntax of `--effect`.
    pub file: Vec<String>,
    /// The change; `None` for a null.
    pub change: Option<Drawn>,
    /// Seed of the flight.
    pub seed: u64,
}

impl OnsetCase {
    /// Draws case `number` of the exam with this seed.
    pub fn draw(seed: u64, number: u64, changes: bool) -> Self {
        let mut draw = Draw::new(seed, number + 1);
        let autopilot =
            [Autopilot::Bundled, Autopilot::Px4, Autopilot::Arducopter][(number % 3) as usize];
        let cause = [
            Cause::Thrust,
            Cause::Rotor0,
            Cause::CentreOfMass,
            Cause::Payload,
            Cause::Wind,
            Cause::Drag,
        ][draw.below(6)];
        // Wind acts through the drag in the file.
        let is_large = changes && cause == Cause::Wind || draw.chance(0.5);
        let vehicle = if is_large { "quad1200" } else { "crazyflie" };
        let (weight, arm, drag) =
            if is_large { (11.77, 0.184, 0.28) } else { (0.294, 0.046, 0.012) };
        let length = if changes { FLIGHT_S } else { NULL_S };
        let trajectory = trajectory(&mut draw, length);
        let thrust = 1.0 + 0.02 * draw.normal();
        let scales: [f64; 3] = std::array::from_fn(|_| rounded(1.0 + 0.05 * draw.normal()));
        let lag = (if is_large { 0.03 } else { 0.04 }) * (1.0 + 0.1 * draw.normal());
        let d_xy = drag * draw.within([0.7, 1.3]);
        let file = vec![
            format!("thrust_scale:scale={}", rounded(thrust)),
            format!("inertia:scale=[{},{},{}]", scales[0], scales[1], scales[2]),
            format!("motor_lag:tau_s={}", rounded(lag)),
            format!("rotor_drag:d_xy={},d_z={}", rounded(d_xy), rounded(0.5 * d_xy)),
        ];
        let at_s = rounded(draw.within(AT_S));
        let change = changes.then(|| {
            let (cause, effect) = match cause {
                Cause::Thrust => {
                    let by = draw.sign() * draw.log_within([0.004, 0.12]);
                    (cause, format!("thrust_scale:scale={}", rounded(thrust * (1.0 + by))))
                }
                Cause::Rotor0 => {
                    let rotor = draw.below(ROTORS);
                    let causes = [Cause::Rotor0, Cause::Rotor1, Cause::Rotor2, Cause::Rotor3];
                    let scale = rounded(1.0 - draw.log_within([0.01, 0.2]));
                    (causes[rotor], format!("rotor_loss:rotor={rotor},scale={scale}"))
                }
                Cause::CentreOfMass => {
                    let (by, angle) = (arm * draw.log_within([0.003, 0.08]), draw.within(ANGLES));
                    let [x, y] = [by * angle.cos(), by * angle.sin()].map(rounded);
                    (cause, format!("com_offset:x_m={x},y_m={y}"))
                }
                Cause::Payload => {
                    let mass = weight / 9.80665 * (1.0 - draw.log_within([0.01, 0.15]));
                    (Cause::Thrust, format!("mass:mass_kg={}", rounded(mass)))
                }
                Cause::Wind => {
                    let (by, angle) = (draw.log_within([0.3, 5.0]), draw.within(ANGLES));
                    let [north, east] = [by * angle.cos(), by * angle.sin()].map(rounded);
                    (cause, format!("wind:north_m_s={north},east_m_s={east}"))
                }
                _ => {
                    let more = d_xy * (1.0 + draw.log_within([0.3, 3.0]));
                    (
                        cause,
                        format!("rotor_drag:d_xy={},d_z={}", rounded(more), rounded(0.5 * d_xy)),
                    )
                }
            };
            Drawn { cause, effect, at_s }
        });
        Self { vehicle, autopilot, trajectory, file, change, seed: draw.seed() >> 32 }
    }

    /// The effects that act throughout, and the one that sets in.
    ///
    /// # Errors
    /// An error of the syntax, which a drawn effect cannot cause.
    pub fn schedule(&self) -> Result<Schedule, EffectError> {
        let mut schedule = Schedule::default();
        for effect in &self.file {
            schedule.effects.insert_argument(effect)?;
        }
        if let Some(change) = &self.change {
            schedule.insert(&change.effect, &change.at_s.to_string())?;
        }
        Ok(schedule)
    }

    /// `config` with a pack that lasts for the flight.
    pub fn configured(config: SitlConfig) -> SitlConfig {
        let mut config = config;
        config.battery.capacity_mah = Some(CAPACITY_MAH);
        config
    }
}

/// A random trajectory of about this length, s.
fn trajectory(draw: &mut Draw, length_s: f64) -> String {
    match draw.below(4) {
        0 => format!("family = \"hover\"\naltitude_m = 1.5\nduration_s = {length_s}\n"),
        1 => format!(
            "family = \"figure-8\"\naltitude_m = 1.5\nduration_s = {length_s}\nlength_m = 3.0\n\
             width_m = 1.5\nperiod_s = {}\nclimb_m = 0.6\n",
            rounded(draw.within([6.0, 12.0]))
        ),
        kind => {
            let speed = rounded(draw.within([0.6, 1.8]));
            let hold = if kind == 2 { 0.3 } else { 2.0 };
            // A leg is about 1.8 m long on average.
            let count = (length_s / (1.8 / speed + speed / 2.0 + hold)).ceil() as usize;
            format!(
                "family = \"random-waypoints\"\naltitude_m = 1.5\nseed = {}\ncount = {count}\n\
                 half_size_m = [1.5, 1.5, 0.5]\nhold_s = {hold}\npace = {{ speed_m_s = {speed}, \
                 acceleration_m_s2 = 2.0, yaw_rate_deg_s = 60.0 }}\n",
                draw.below(1_000_000)
            )
        }
    }
}

/// The recorded motion of a flight, to measure its change's strength.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Reported states with their times on the vehicle's clock, s.
    pub reports: Vec<(f64, State)>,
    /// True states with their times and the rotors' thrusts, N.
    pub truth: Vec<(f64, State, [f64; ROTORS])>,
    /// Motor outputs, 0..1, with their times.
    pub outputs: Vec<(f64, [f64; ROTORS])>,
}

/// Errors of velocity, position, body rate and angle, three axes each.
type Errors = [f64; 12];

impl Recorded {
    /// The strength of a change: its RMS effect on predictions of a second over the 5 s after it,
    /// divided by the RMS error of the true vehicle's predictions before it, which follow the
    /// reported outputs and attitude. It is the largest ratio of position, velocity, angle and body
    /// rate.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn strength(
        &self,
        vehicle: &VehicleParams,
        schedule: &Schedule,
    ) -> Result<f64, VehicleError> {
        let Some(onset) = schedule.onsets.first() else { return Ok(0.0) };
        let before = Physics::new(vehicle, &schedule.effects)?;
        let effects: EffectSet = schedule.effects.overlay(&onset.effects);
        let after = Physics::new(vehicle, &effects)?;
        let at = onset.at_s;
        let due = windows(at, at + OVER_S - HORIZON_S)
            .map(|start| self.due(start, &before, &after))
            .collect::<Vec<_>>();
        let noise = windows(at - NOISE_S, at - HORIZON_S)
            .filter_map(|start| self.missed(start, &before))
            .collect::<Vec<_>>();
        let square = |errors: &[Errors], channel: usize| {
            let sum: f64 = errors.iter().map(|error| error[channel].powi(2)).sum();
            sum / errors.len().max(1) as f64
        };
        let ratio = |channel| (square(&due, channel) / square(&noise, channel).max(1e-30)).sqrt();
        Ok((0..12).map(ratio).fold(0.0, f64::max))
    }

    /// The effect of the change alone on a prediction.
    fn due(&self, start: f64, before: &Physics, after: &Physics) -> Errors {
        let from = self.truth.partition_point(|(time, ..)| *time < start);
        let to = self.truth.partition_point(|(time, ..)| *time < start + HORIZON_S);
        let mut sum = Sums::default();
        for (_, state, thrusts) in &self.truth[from..to] {
            let rotors =
                std::array::from_fn(|i| thrusts[i] / after.constants().rotors[i].thrust_max);
            let [(v0, w0), (v1, w1)] = [before, after]
                .map(|physics| physics.accelerations(state, &rotors, &physics.calm()));
            sum.add(v1 - v0, w1 - w0, STEP_S);
        }
        sum.0
    }

    /// The error of the true vehicle's prediction against the reports.
    fn missed(&self, start: f64, physics: &Physics) -> Option<Errors> {
        let at = |time: f64| {
            let index = self.reports.partition_point(|(t, _)| *t < time);
            self.reports.get(index).filter(|(t, _)| *t < time + 5.0 * STEP_S)
        };
        let (begin, first) = at(start)?;
        let lag = Lag::new(physics.constants().motor_time_constant, STEP_S);
        let held = |time: f64| {
            let index = self.outputs.partition_point(|(t, _)| *t <= time).checked_sub(1)?;
            self.outputs.get(index).map(|(_, outputs)| *outputs)
        };
        let mut rotors = held(begin - 0.4)?;
        for k in 0..40 {
            rotors = lag.advance(&rotors, &held(begin - 0.4 + f64::from(k) * STEP_S)?)[1];
        }
        let mut sum = Sums::default();
        let mut turned = Frd::zero();
        let (mut time, mut state) = (*begin, *first);
        while time < begin + HORIZON_S {
            let [mean, end] = lag.advance(&rotors, &held(time)?);
            rotors = end;
            let (linear, angular) = physics.accelerations(&state, &mean, &physics.calm());
            sum.add(linear, angular, STEP_S);
            time += STEP_S;
            state = at(time)?.1;
            turned += (state.body_rate - first.body_rate) * STEP_S;
        }
        let span = time - begin;
        let moved = state.position - first.position - first.velocity * span;
        let gained = state.velocity - first.velocity;
        let spun = state.body_rate - first.body_rate;
        let seen = [gained.to_array(), moved.to_array(), spun.to_array(), turned.to_array()];
        Some(std::array::from_fn(|i| seen[i / 3][i % 3] - sum.0[i]))
    }
}

fn windows(from: f64, to: f64) -> impl Iterator<Item = f64> {
    let count = ((to - from) / SPACING_S).floor() as usize;
    (0..=count).map(move |k| from + k as f64 * SPACING_S)
}

/// Accelerations, integrated once and twice.
#[derive(Default)]
struct Sums(Errors);

impl Sums {
    fn add(&mut self, linear: Ned, angular: Frd, step: f64) {
        for axis in 0..3 {
            let Self(sums) = self;
            sums[3 + axis] += sums[axis] * step;
            sums[axis] += linear.to_array()[axis] * step;
            sums[9 + axis] += sums[6 + axis] * step;
            sums[6 + axis] += angular.to_array()[axis] * step;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_onset_draw_is_simulable_and_reproducible() {
        for number in 0..200 {
            let case = OnsetCase::draw(3, number, true);
            let schedule = case.schedule().expect("a schedule");
            assert_eq!(schedule.onsets.len(), 1);
            let vehicle = VehicleParams::load(case.vehicle).expect("a vehicle");
            let effects = schedule.effects.overlay(&schedule.onsets[0].effects);
            Physics::new(&vehicle, &effects).expect("a physics");
            assert_eq!(case.trajectory, OnsetCase::draw(3, number, true).trajectory);
        }
        assert!(OnsetCase::draw(3, 1, false).change.is_none());
    }
}

//! The vehicle's true motion: where it may be while the controller flies it, and how flights end.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rule::Rule;
use super::script::{Fault, PilotAct, Script, Timed};

/// Margin around the trajectory's box, m.
const MARGIN_M: f64 = 3.0;
/// Radius of the fence, m.
const FENCE_M: f64 = 30.0;
/// Largest tilt, rad.
const TILT_MAX_RAD: f64 = 1.2;
/// Largest speed, m/s.
const SPEED_MAX_M_S: f64 = 6.0;
/// Time from the first setpoint that arrives until the slowest autopilot here begins to turn the
/// vehicle, s: its delay, its filters and the rotors' lag.
const REACT_S: f64 = 0.1;
/// Deceleration with which any vehicle here brakes in still air from then on, turning included,
/// m/s^2.
const BRAKE_M_S2: f64 = 3.0;
/// The same in any tailwind that it can be flown in, m/s^2.
const BRAKE_LEAST_M_S2: f64 = 0.5;
/// Acceleration by a force as large as the vehicle's weight, m/s^2.
const WEIGHT_M_S2: f64 = 9.81;
/// Loss of thrust beyond which a rotor makes the vehicle impossible to fly.
const FLYABLE_LOSS: f64 = 0.35;
/// Time within which setpoints to such a vehicle must end, s: the tilt's dwell time, and the
/// hand-over.
const LET_GO_S: f64 = 4.0;

/// The vehicle's true state.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Simulated time, us.
    pub now_us: u64,
    /// Position north, east, down, m.
    pub position: [f64; 3],
    /// Velocity north, east, down, m/s.
    pub velocity: [f64; 3],
    /// Tilt, rad.
    pub tilt_rad: f64,
    /// Whether its motors are armed.
    pub is_armed: bool,
    /// Whether its mode obeys setpoints.
    pub obeys: bool,
}

/// Who controls the vehicle at the end.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// Nobody: the motors are off.
    Landed,
    /// The vehicle holds its place.
    Holding,
    /// The pilot.
    Pilot,
    /// Its own failsafe, or its own landing.
    Failsafe,
    /// The vehicle obeys setpoints, and none arrive.
    Adrift,
}

/// A wind from its begin on.
struct Wind {
    /// Simulated time at which it begins, us.
    begin_us: u64,
    /// Acceleration of the vehicle by it, north and east, m/s^2.
    push: [f64; 2],
}

impl Wind {
    fn of(timed: &Timed) -> Option<Self> {
        let Fault::Wind { share, towards_rad } = timed.fault else { return None };
        let (sin, cos) = towards_rad.sin_cos();
        let push = [cos, sin].map(|part| share * WEIGHT_M_S2 * part);
        Some(Self { begin_us: (timed.at_s * 1e6) as u64, push })
    }
}

/// Where the vehicle may be: around the trajectory, which begins where the vehicle was armed.
pub(super) struct Envelope {
    /// North and east of the place where it was last disarmed, m.
    origin: [f64; 2],
    low: [f64; 3],
    high: [f64; 3],
    is_possible: bool,
    /// The lasting winds of the script.
    winds: Vec<Wind>,
    lost_us: Option<u64>,
    /// Whether it left the envelope while no setpoints reached it, or was then too fast to stop
    /// within it, and has not been back since.
    is_astray: bool,
}

impl Envelope {
    pub fn new(script: &Script, path: &[[f64; 3]]) -> Self {
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        // A lying planner leads anywhere within the fence.
        let lies = |fault: &Fault| matches!(fault, Fault::PlannerLies { .. });
        let is_led_astray = script.faults.iter().any(|timed| lies(&timed.fault));
        let margin_m = if is_led_astray { FENCE_M + MARGIN_M } else { MARGIN_M };
        for point in path {
            for axis in 0..3 {
                low[axis] = f64::min(low[axis], point[axis] - margin_m);
                high[axis] = f64::max(high[axis], point[axis] + margin_m);
            }
        }
        // Faults that no controller can compensate.
        let breaks = |fault: &Fault| match fault {
            Fault::Rotor { loss, .. } => *loss > FLYABLE_LOSS,
            Fault::Injected { .. } | Fault::Reboot => true,
            Fault::Pilot { act } => *act == PilotAct::Kill,
            _ => false,
        };
        let is_possible = !script.faults.iter().any(|timed| breaks(&timed.fault));
        let winds = script.faults.iter().filter_map(Wind::of).collect();
        Self { origin: [0.0; 2], low, high, is_possible, winds, lost_us: None, is_astray: false }
    }

    /// Deceleration with which a vehicle brakes from this motion, m/s^2: less by what the winds so
    /// far push it along.
    fn brake_m_s2(&self, seen: &Seen) -> f64 {
        let [north, east, _] = seen.velocity;
        let speed = north.hypot(east).max(f64::MIN_POSITIVE);
        let winds = self.winds.iter().filter(|wind| wind.begin_us <= seen.now_us);
        let along: f64 =
            winds.map(|wind| (wind.push[0] * north + wind.push[1] * east) / speed).sum();
        (BRAKE_M_S2 - along.max(0.0)).max(BRAKE_LEAST_M_S2)
    }

    /// The broken rule, if any, while the vehicle obeys and setpoints reach it.
    pub fn sees(&mut self, seen: &Seen, is_led: bool) -> Option<(Rule, String)> {
        let [north, east, down] = seen.position;
        if !seen.is_armed {
            self.origin = [north, east];
        }
        let place = [north - self.origin[0], east - self.origin[1], down];
        let speed = seen.velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        let stop_s = REACT_S + speed / (2.0 * self.brake_m_s2(seen));
        let is_near_in = |time_s: f64| {
            (0..3).all(|axis| {
                let there = place[axis] + seen.velocity[axis] * time_s;
                (self.low[axis]..=self.high[axis]).contains(&there)
            })
        };
        let is_well = is_near_in(0.0) && seen.tilt_rad <= TILT_MAX_RAD && speed <= SPEED_MAX_M_S;
        let can_stop = is_near_in(stop_s);
        if !(seen.is_armed && seen.obeys && is_led) {
            self.lost_us = None;
            self.is_astray = !(is_well && can_stop);
            return None;
        }
        let what = format!("{seen:?}");
        if self.is_possible {
            self.is_astray &= !(is_well && can_stop);
            return (!is_well && !self.is_astray).then_some((Rule::Envelope, what));
        }
        // The controller is not responsible for its position and speed, but must notice that it
        // fell over.
        if seen.tilt_rad <= TILT_MAX_RAD {
            self.lost_us = None;
            return None;
        }
        let lost_us = *self.lost_us.get_or_insert(seen.now_us);
        let for_s = seen.now_us.saturating_sub(lost_us) as f64 * 1e-6;
        (for_s > LET_GO_S).then_some((Rule::LetGo, what))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::campaign::draw;

    /// The rule broken by a vehicle that moves east from `east` at `speed`, while setpoints are
    /// lost until `lost_s`.
    fn judged(east: f64, speed: f64, lost_s: f64) -> Option<Rule> {
        judged_under(Vec::new(), east, speed, lost_s)
    }

    fn judged_under(faults: Vec<Timed>, east: f64, speed: f64, lost_s: f64) -> Option<Rule> {
        let script = Script { faults, ..draw::script(1, 1) };
        let mut envelope = Envelope::new(&script, &[[0.0, 0.0, -1.0]]);
        let still = Seen {
            now_us: 0,
            position: [0.0; 3],
            velocity: [0.0; 3],
            tilt_rad: 0.1,
            is_armed: false,
            obeys: true,
        };
        envelope.sees(&still, false);
        (0..200u64).find_map(|k| {
            let t = k as f64 * 0.01;
            let position = [0.0, east + speed * t, -1.0];
            let velocity = [0.0, speed, 0.0];
            let seen = Seen { now_us: k * 10_000, position, velocity, is_armed: true, ..still };
            envelope.sees(&seen, t >= lost_s).map(|(rule, _)| rule)
        })
    }

    #[test]
    fn unavoidable_overshoot_after_setpoint_loss_is_no_violation() {
        assert_eq!(judged(0.0, 2.5, 0.0), Some(Rule::Envelope), "flown out of the envelope");
        assert_eq!(judged(0.0, 2.5, 0.3), Some(Rule::Envelope), "it could have stopped");
        assert_eq!(judged(0.0, 2.5, 0.9), None, "it could not have stopped");
        assert_eq!(judged(0.0, 2.0, 1.1), None, "nor before it began to turn");
        assert_eq!(judged(0.0, 2.0, 1.0), Some(Rule::Envelope), "it could have turned in time");
        assert_eq!(
            judged(2.9, 0.5, 0.0),
            Some(Rule::Envelope),
            "slow, but flown out of the envelope"
        );
    }

    #[test]
    fn only_a_wind_from_behind_that_blows_lengthens_the_way_to_a_stop() {
        let wind = |at_s: f64, towards_rad: f64| {
            let fault = Fault::Wind { share: 0.2, towards_rad };
            vec![Timed { at_s, for_s: 0.0, fault }]
        };
        let judged = |faults| judged_under(faults, 0.0, 2.5, 0.5);
        assert_eq!(judged(Vec::new()), Some(Rule::Envelope), "it could have stopped");
        assert_eq!(judged(wind(0.0, FRAC_PI_2)), None, "it could not have stopped");
        assert_eq!(judged(wind(0.0, -FRAC_PI_2)), Some(Rule::Envelope), "against the wind");
        assert_eq!(judged(wind(0.0, 0.0)), Some(Rule::Envelope), "across the wind");
        assert_eq!(judged(wind(1.9, FRAC_PI_2)), Some(Rule::Envelope), "before the wind");
    }
}

//! Check, before arming, that a trajectory stays within the flight envelope.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Euler, Frd, Ned};

use super::planned::Plan;
use super::problem::YAW;
use super::trajectory::Trajectory;

/// Limits on the demands of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlightEnvelope {
    /// Largest speed, m/s.
    pub speed_max_m_s: f64,
    /// Largest tilt that the acceleration needs, degrees.
    pub tilt_max_deg: f64,
    /// Largest specific thrust that the acceleration needs, in units of gravity.
    pub thrust_max_g: f64,
    /// Largest yaw rate, degrees/s.
    pub yaw_rate_max_deg_s: f64,
    /// Largest horizontal distance from the take-off point, m.
    pub radius_max_m: f64,
    /// Greatest height above the take-off floor, m.
    pub height_max_m: f64,
    /// Lowest height above the take-off floor, m.
    pub height_min_m: f64,
}

impl Default for FlightEnvelope {
    fn default() -> Self {
        Self {
            speed_max_m_s: 5.0,
            tilt_max_deg: 35.0,
            thrust_max_g: 1.6,
            yaw_rate_max_deg_s: 180.0,
            radius_max_m: 20.0,
            height_max_m: 20.0,
            height_min_m: 0.2,
        }
    }
}

/// A limit that a trajectory exceeds, and where it does so most.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "trajectory {trajectory} cannot be flown: {quantity} reaches {found:.2} {unit} at {at_s:.2} s, \
     the limit is {limit:.2} {unit}; change the trajectory or [envelope] in the configuration"
)]
pub struct InfeasibleTrajectory {
    trajectory: String,
    quantity: &'static str,
    unit: &'static str,
    found: f64,
    limit: f64,
    at_s: f64,
}

/// The largest demands of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Feasibility {
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Tilt, degrees.
    pub tilt_deg: f64,
    /// Yaw rate, degrees/s.
    pub yaw_rate_deg_s: f64,
    /// Horizontal distance from the take-off point, m.
    pub radius_m: f64,
    /// Height, m.
    pub height_m: f64,
}

/// Sampling interval of the check, s.
const SPACING_S: f64 = 0.01;

/// The demands of one instant.
struct Demand {
    at_s: f64,
    speed_m_s: f64,
    tilt_deg: f64,
    thrust_g: f64,
    yaw_rate_deg_s: f64,
    radius_m: f64,
    height_m: f64,
}

impl Demand {
    /// The demands of a position with a velocity and a specific force, world axes.
    fn new(at_s: f64, position: Ned, velocity: Ned, force: Ned, gravity: f64) -> Self {
        let horizontal = force.north().hypot(force.east());
        Self {
            at_s,
            speed_m_s: velocity.norm(),
            tilt_deg: horizontal.atan2(-force.down()).to_degrees(),
            thrust_g: force.norm() / gravity,
            yaw_rate_deg_s: 0.0,
            radius_m: position.north().hypot(position.east()),
            height_m: -position.down(),
        }
    }
}

impl FlightEnvelope {
    /// The trajectory's largest demands, if none exceeds a limit.
    ///
    /// An acceleration `a` needs a thrust along `a - g`, so tilt is atan2(|a_horizontal|, g -
    /// a_down), without drag.
    ///
    /// # Errors
    /// [`InfeasibleTrajectory`] for the limit exceeded by the largest factor.
    pub fn check(
        &self,
        trajectory: &Trajectory,
        gravity: f64,
    ) -> Result<Feasibility, InfeasibleTrajectory> {
        let steps = (trajectory.duration() / SPACING_S).ceil() as usize;
        let demands = (0..=steps).map(|step| {
            let at_s = (step as f64 * SPACING_S).min(trajectory.duration());
            let point = trajectory.sample(at_s);
            let force = point.acceleration - Ned::new(0.0, 0.0, gravity);
            let yaw_rate_deg_s = point.yaw_rate.abs().to_degrees();
            let demand = Demand::new(at_s, point.position, point.velocity, force, gravity);
            Demand { yaw_rate_deg_s, ..demand }
        });
        self.judge(trajectory.name(), demands)
    }

    /// The largest demands of a plan, from its states and thrusts, if none exceeds a limit.
    ///
    /// # Errors
    /// As [`FlightEnvelope::check`].
    pub fn check_plan(
        &self,
        plan: &Plan,
        mass_kg: f64,
        gravity: f64,
    ) -> Result<Feasibility, InfeasibleTrajectory> {
        let demands =
            plan.inputs.iter().zip(&plan.states).enumerate().map(|(n, (input, state))| {
                let [x, y, z, vx, vy, vz, roll, pitch, yaw, ..] = *state;
                let attitude = Euler::new(roll, pitch, yaw).attitude();
                let force = attitude.to_world(Frd::new(0.0, 0.0, -input[0] / mass_kg));
                let (position, velocity) = (Ned::new(x, y, z), Ned::new(vx, vy, vz));
                let next_yaw = plan.states[n + 1][YAW];
                let demand =
                    Demand::new(n as f64 * plan.period_s, position, velocity, force, gravity);
                Demand {
                    yaw_rate_deg_s: ((next_yaw - yaw) / plan.period_s).abs().to_degrees(),
                    ..demand
                }
            });
        self.judge(&plan.trajectory, demands)
    }

    fn judge(
        &self,
        trajectory: &str,
        demands: impl Iterator<Item = Demand>,
    ) -> Result<Feasibility, InfeasibleTrajectory> {
        let mut largest = Feasibility::default();
        let mut worst: Option<(f64, InfeasibleTrajectory)> = None;
        for demand in demands {
            let Demand { at_s, speed_m_s, tilt_deg, thrust_g, yaw_rate_deg_s, radius_m, height_m } =
                demand;
            largest.speed_m_s = largest.speed_m_s.max(speed_m_s);
            largest.tilt_deg = largest.tilt_deg.max(tilt_deg);
            largest.yaw_rate_deg_s = largest.yaw_rate_deg_s.max(yaw_rate_deg_s);
            largest.radius_m = largest.radius_m.max(radius_m);
            largest.height_m = largest.height_m.max(height_m);
            let rows = [
                ("speed", "m/s", speed_m_s, self.speed_max_m_s),
                ("tilt", "deg", tilt_deg, self.tilt_max_deg),
                ("specific thrust", "g", thrust_g, self.thrust_max_g),
                ("yaw rate", "deg/s", yaw_rate_deg_s, self.yaw_rate_max_deg_s),
                ("distance from the take-off point", "m", radius_m, self.radius_max_m),
                ("height", "m", height_m, self.height_max_m),
            ];
            let broken = |quantity, unit, found, limit| InfeasibleTrajectory {
                trajectory: trajectory.to_owned(),
                quantity,
                unit,
                found,
                limit,
                at_s,
            };
            for (quantity, unit, found, limit) in rows {
                let excess = found / limit;
                let broken_here = excess > 1.0 || excess.is_nan();
                if broken_here && worst.as_ref().is_none_or(|(most, _)| excess > *most) {
                    worst = Some((excess, broken(quantity, unit, found, limit)));
                }
            }
            if height_m < self.height_min_m && worst.is_none() {
                worst = Some((1.0, broken("lowest height", "m", height_m, self.height_min_m)));
            }
        }
        worst.map_or(Ok(largest), |(_, error)| Err(error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn check(text: &str) -> Result<Feasibility, InfeasibleTrajectory> {
        let trajectory = Trajectory::parse(text, Path::new("t.toml")).expect("a trajectory");
        FlightEnvelope::default().check(&trajectory, 9.81)
    }

    #[test]
    fn circle_tilt_matches_centripetal_acceleration() {
        let demands = check(
            "family='sinusoid-yaw'\naltitude_m=1\nduration_s=10\namplitude_m=1\nperiod_s=5\nyaw_period_s=10",
        );
        let omega = std::f64::consts::TAU / 5.0;
        let tilt = (omega * omega / 9.81).atan().to_degrees();
        assert!((demands.expect("flyable").tilt_deg - tilt).abs() < 0.2);
    }

    #[test]
    fn infeasible_turns_and_floor_crossings_are_refused_by_quantity() {
        let fast = "family='sinusoid-yaw'\naltitude_m=1\nduration_s=10\namplitude_m=5\nperiod_s=0.6\nyaw_period_s=10";
        let message = check(fast).expect_err("refused").to_string();
        assert!(message.contains("specific thrust") || message.contains("speed"), "{message}");
        let low = "family='sinusoid-xz'\naltitude_m=1\nduration_s=10\namplitude_m=[0.1,1.2]\nperiod_s=[5,8]";
        assert!(check(low).expect_err("refused").to_string().contains("lowest height"));
    }
}

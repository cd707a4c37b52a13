//! Volume and dynamics that a programme may use.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ProgrammeError;
use crate::plan::feasibility::FlightEnvelope;
use crate::plan::trajectory::DesiredPoint;

/// Volume and dynamics of a programme. The [`FlightEnvelope`] and the vehicle's capability cap
/// these values.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProgrammeSettings {
    /// Half of the box's side to the north and to the east, around the take-off point, m.
    pub half_size_m: [f64; 2],
    /// Lowest desired height above the take-off floor, m. Without integral action, a vehicle with
    /// less thrust than its file states flies a few decimetres lower.
    pub height_min_m: f64,
    /// Greatest desired height, m.
    pub height_max_m: f64,
    /// Largest desired speed, m/s.
    pub speed_max_m_s: f64,
    /// Largest tilt that the desired acceleration needs, degrees.
    pub tilt_max_deg: f64,
    /// Largest desired yaw rate, degrees/s.
    pub yaw_rate_max_deg_s: f64,
    /// Headings of the flights without yaw motion, used in turn, degrees.
    pub headings_deg: Vec<f64>,
    /// Approximate length of each flight's trajectory, s.
    pub flight_s: f64,
}

impl Default for ProgrammeSettings {
    fn default() -> Self {
        Self {
            half_size_m: [2.0, 2.0],
            height_min_m: 0.6,
            height_max_m: 2.4,
            speed_max_m_s: 2.5,
            tilt_max_deg: 30.0,
            yaw_rate_max_deg_s: 150.0,
            headings_deg: vec![0.0],
            flight_s: 60.0,
        }
    }
}

/// Capability of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capability {
    /// m/s^2
    pub gravity: f64,
    /// Thrust at full output over the weight.
    pub thrust_to_weight: f64,
    /// Natural frequency of the attitude loop in roll and pitch, the slower of both, rad/s.
    pub tilt_bandwidth: f64,
    /// Natural frequency in yaw, rad/s.
    pub yaw_bandwidth: f64,
}

/// Fraction of the envelope in use: feedback overshoots.
pub(in crate::plan) const MARGIN: f64 = 0.9;
/// Fraction of the vehicle's thrust that a trajectory may need; the rest is for feedback, and for a
/// pack that is not full.
pub(in crate::plan) const THRUST_SHARE: f64 = 0.72;
/// Least specific thrust in units of gravity: rotors must keep their authority.
const THRUST_MIN_G: f64 = 0.5;
/// Largest vertical acceleration, in units of gravity.
const CLIMB_G: f64 = 0.3;

/// Fractions of the speed limit, and of the limits of tilt, thrust and vertical acceleration.
#[derive(Clone, Copy)]
pub(super) struct Share {
    pub speed: f64,
    pub acceleration: f64,
}

impl Share {
    pub fn times(self, factor: f64) -> Self {
        Self { speed: factor * self.speed, acceleration: factor * self.acceleration }
    }

    pub fn rest(self) -> Self {
        Self { speed: 1.0 - self.speed, acceleration: 1.0 - self.acceleration }
    }
}

/// The limits from settings, envelope and vehicle together.
pub(super) struct Limits {
    gravity: f64,
    pub half_size: [f64; 2],
    pub height: [f64; 2],
    speed: f64,
    tilt_tan: f64,
    thrust_g: f64,
    /// rad/s
    pub yaw_rate: f64,
    /// rad/s
    pub tilt_bandwidth: f64,
    /// rad/s
    pub yaw_bandwidth: f64,
}

impl Limits {
    pub fn new(
        settings: &ProgrammeSettings,
        envelope: &FlightEnvelope,
        capability: &Capability,
    ) -> Result<Self, ProgrammeError> {
        // The corners of the box are at most on the envelope's circle.
        let side = MARGIN * envelope.radius_max_m / 2f64.sqrt();
        let floor = settings.height_min_m.max(1.05 * envelope.height_min_m);
        let ceiling = settings.height_max_m.min(MARGIN * envelope.height_max_m);
        let tilt_deg = settings.tilt_max_deg.min(MARGIN * envelope.tilt_max_deg);
        let yaw_rate = settings.yaw_rate_max_deg_s.min(MARGIN * envelope.yaw_rate_max_deg_s);
        let limits = Self {
            gravity: capability.gravity,
            half_size: settings.half_size_m.map(|half| half.min(side)),
            height: [floor, ceiling],
            speed: settings.speed_max_m_s.min(MARGIN * envelope.speed_max_m_s),
            tilt_tan: tilt_deg.to_radians().tan(),
            thrust_g: (THRUST_SHARE * capability.thrust_to_weight)
                .min(1.0 + MARGIN * (envelope.thrust_max_g - 1.0)),
            yaw_rate: yaw_rate.to_radians(),
            tilt_bandwidth: capability.tilt_bandwidth,
            yaw_bandwidth: capability.yaw_bandwidth,
        };
        let room = |quantity, found: f64, least: f64, expected| {
            if found >= least {
                Ok(())
            } else {
                Err(ProgrammeError::NoRoom { quantity, found, expected })
            }
        };
        let half = limits.half_size[0].min(limits.half_size[1]);
        room("half a side", half, 0.2, "expected at least 0.2 m")?;
        room("a height", ceiling - floor, 0.3, "expected at least 0.3 m between low and high")?;
        room("a speed", limits.speed, 0.1, "expected at least 0.1 m/s")?;
        room("a tilt", tilt_deg, 2.0, "expected at least 2 degrees")?;
        room("a yaw rate", yaw_rate, 1.0, "expected at least 1 degree/s")?;
        room("a specific thrust", limits.thrust_g, 1.1, "expected at least 1.1 g")?;
        room("a bandwidth", limits.tilt_bandwidth, 1.0, "expected at least 1 rad/s")?;
        room("a yaw bandwidth", limits.yaw_bandwidth, 1.0, "expected at least 1 rad/s")?;
        Ok(limits)
    }

    /// Whether the motion of `point` times `scale` is within `share` of the limits. The allowed set
    /// is convex, so two motions whose shares add up to 1 may be added.
    pub fn allow(&self, point: &DesiredPoint, scale: f64, share: Share) -> bool {
        let [north, east, down] = (point.acceleration * scale).into();
        let lift = self.gravity - down;
        let horizontal = f64::hypot(north, east);
        let part = share.acceleration;
        let thrust = 1.0 + part * (self.thrust_g - 1.0);
        let least = 1.0 - part * (1.0 - THRUST_MIN_G);
        scale * point.velocity.norm() <= share.speed * self.speed
            && horizontal <= self.tilt_tan * (part * self.gravity - down)
            && f64::hypot(horizontal, lift) <= thrust * self.gravity
            && lift >= least * self.gravity
            && f64::abs(down) <= part * CLIMB_G * self.gravity
    }
}

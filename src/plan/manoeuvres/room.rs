//! Volume and dynamics for the manoeuvres.

use crate::plan::feasibility::FlightEnvelope;
use crate::plan::programme::{Capability, MARGIN, ProgrammeSettings, THRUST_SHARE};

/// Largest vertical acceleration, in units of gravity.
const CLIMB_MAX_G: f64 = 0.35;
/// Lowest hover relative to the envelope's least height.
const LOWEST: f64 = 1.25;

/// Volume around the take-off point and limits of the motion, within the vehicle's capability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// m/s^2
    pub gravity: f64,
    /// Half of the box's side, m.
    pub half_size_m: f64,
    /// Lowest and greatest height of the motion, m.
    pub height_m: [f64; 2],
    /// Lowest height of a slow flight over the floor, m.
    pub lowest_m: f64,
    /// Largest speed, m/s.
    pub speed_m_s: f64,
    /// Largest horizontal acceleration, m/s^2.
    pub lateral_m_s2: f64,
    /// Largest vertical acceleration, m/s^2.
    pub climb_m_s2: f64,
    /// Largest yaw rate, degrees/s.
    pub yaw_rate_deg_s: f64,
}

impl Room {
    /// The room of a data collection programme.
    pub fn new(
        settings: &ProgrammeSettings,
        envelope: &FlightEnvelope,
        capability: &Capability,
    ) -> Self {
        let [north, east] = settings.half_size_m;
        let side = MARGIN * envelope.radius_max_m / 2f64.sqrt();
        let tilt_deg = settings.tilt_max_deg.min(MARGIN * envelope.tilt_max_deg);
        let spare_g = (THRUST_SHARE * capability.thrust_to_weight)
            .min(1.0 + MARGIN * (envelope.thrust_max_g - 1.0))
            - 1.0;
        let climb_g = spare_g.clamp(0.05, CLIMB_MAX_G);
        // Tilted thrust must also carry the weight.
        let lateral_g = ((1.0 + spare_g.max(0.05)).powi(2) - 1.0).sqrt();
        let ceiling = settings.height_max_m.min(MARGIN * envelope.height_max_m);
        let lowest_m = LOWEST * envelope.height_min_m;
        Self {
            gravity: capability.gravity,
            half_size_m: north.min(east).min(side),
            height_m: [settings.height_min_m.max(lowest_m).min(ceiling), ceiling],
            lowest_m,
            speed_m_s: settings.speed_max_m_s.min(MARGIN * envelope.speed_max_m_s),
            lateral_m_s2: lateral_g.min(tilt_deg.to_radians().tan()) * capability.gravity,
            climb_m_s2: climb_g * capability.gravity,
            yaw_rate_deg_s: settings.yaw_rate_max_deg_s.min(MARGIN * envelope.yaw_rate_max_deg_s),
        }
    }

    /// The middle of the height range, m.
    pub(super) fn middle(&self) -> f64 {
        0.5 * (self.height_m[0] + self.height_m[1])
    }

    /// Half of the range of heights, m.
    pub(super) fn half_height(&self) -> f64 {
        0.5 * (self.height_m[1] - self.height_m[0])
    }

    /// `count` heights, evenly spaced from the lowest to the greatest, m.
    pub(super) fn levels(&self, count: usize) -> Vec<f64> {
        let [low, high] = self.height_m;
        (0..count).map(|i| low + (high - low) * i as f64 / (count - 1) as f64).collect()
    }
}

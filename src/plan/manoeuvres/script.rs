//! Waypoints as a trajectory file.

use std::fmt::Write;

use super::Room;

/// Builder of a trajectory file of the family `waypoints`.
pub(super) struct Script {
    speed_m_s: f64,
    acceleration_m_s2: f64,
    climb_m_s2: f64,
    yaw_rate_deg_s: f64,
    points: String,
}

impl Script {
    /// Starts without waypoints; the pace is for level flight.
    pub fn new(room: &Room) -> Self {
        Self {
            speed_m_s: room.speed_m_s,
            acceleration_m_s2: room.lateral_m_s2.min(0.35 * room.gravity),
            climb_m_s2: room.climb_m_s2,
            yaw_rate_deg_s: 0.6 * room.yaw_rate_deg_s,
            points: String::new(),
        }
    }

    /// Changes to the pace of climbs.
    pub fn climbing(self) -> Self {
        Self { acceleration_m_s2: self.climb_m_s2, ..self }
    }

    /// Adds a waypoint: position (north, east, up), heading and hold time.
    pub fn at(mut self, [north, east, up]: [f64; 3], yaw_deg: f64, hold_s: f64) -> Self {
        // Writing to a string does not fail.
        let _ = write!(
            self.points,
            "\n[[points]]\nnorth_m = {north:.3}\neast_m = {east:.3}\naltitude_m = {up:.3}\n\
             yaw_deg = {yaw_deg:.1}\nhold_s = {hold_s:.1}\n"
        );
        self
    }

    /// The content of the file.
    pub fn to_toml(&self) -> String {
        format!(
            "family = \"waypoints\"\n\n[pace]\nspeed_m_s = {:.3}\nacceleration_m_s2 = {:.3}\n\
             yaw_rate_deg_s = {:.1}\n{}",
            self.speed_m_s, self.acceleration_m_s2, self.yaw_rate_deg_s, self.points
        )
    }
}

//! What a trajectory file may say.

use std::path::PathBuf;

use serde::Deserialize;

use crate::plan::multisine::Multisine;

/// A trajectory file. Lengths in m, angles in degrees where the name says so, altitudes above the
/// take-off floor, positions relative to the take-off point.
#[derive(Debug, Deserialize)]
#[serde(tag = "family", rename_all = "kebab-case")]
pub(super) enum Family {
    Hover(Hover),
    /// Two sinusoids in one plane, yaw still.
    SinusoidXy(Sinusoid),
    SinusoidXz(Sinusoid),
    SinusoidYz(Sinusoid),
    /// Turning in place.
    YawRotation(YawRotation),
    /// Sinusoids in xy while turning: the paper's experiment.
    SinusoidYaw(SinusoidYaw),
    #[serde(rename = "figure-8")]
    FigureEight(FigureEight),
    /// Sums of sinusoids in position and yaw.
    Multisine(Multisine),
    Steps(Steps),
    RandomWaypoints(RandomWaypoints),
    Waypoints(Waypoints),
    Csv(Csv),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Hover {
    pub altitude_m: f64,
    pub duration_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sinusoid {
    pub altitude_m: f64,
    pub duration_s: f64,
    /// Of the plane's first and second axis.
    pub amplitude_m: [f64; 2],
    pub period_s: [f64; 2],
    #[serde(default)]
    pub phase_deg: [f64; 2],
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct YawRotation {
    pub altitude_m: f64,
    pub duration_s: f64,
    /// Constant turning.
    #[serde(default)]
    pub yaw_rate_deg_s: f64,
    /// Swing on top of it.
    #[serde(default)]
    pub yaw_amplitude_deg: f64,
    #[serde(default = "four_seconds")]
    pub yaw_period_s: f64,
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SinusoidYaw {
    pub altitude_m: f64,
    pub duration_s: f64,
    pub amplitude_m: f64,
    pub period_s: f64,
    pub yaw_period_s: f64,
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FigureEight {
    pub altitude_m: f64,
    pub duration_s: f64,
    pub length_m: f64,
    pub width_m: f64,
    pub period_s: f64,
    #[serde(default)]
    pub climb_m: f64,
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Steps {
    pub altitude_m: f64,
    pub dwell_s: f64,
    /// North, east, up in m and yaw in degrees, relative to the hover point; each held for the
    /// dwell.
    pub offsets: Vec<[f64; 4]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RandomWaypoints {
    pub altitude_m: f64,
    pub seed: u64,
    pub count: usize,
    pub half_size_m: [f64; 3],
    #[serde(default)]
    pub hold_s: f64,
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Waypoints {
    pub points: Vec<WaypointFields>,
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct PaceFields {
    pub speed_m_s: f64,
    pub acceleration_m_s2: f64,
    pub yaw_rate_deg_s: f64,
}

impl Default for PaceFields {
    fn default() -> Self {
        Self { speed_m_s: 1.0, acceleration_m_s2: 1.0, yaw_rate_deg_s: 45.0 }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaypointFields {
    pub north_m: f64,
    pub east_m: f64,
    pub altitude_m: f64,
    #[serde(default)]
    pub yaw_deg: f64,
    #[serde(default)]
    pub hold_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Csv {
    /// Relative to the trajectory file.
    pub file: PathBuf,
}

pub(in crate::plan) fn two_seconds() -> f64 {
    2.0
}

fn four_seconds() -> f64 {
    4.0
}

//! What a trajectory file may say.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Deserialize;

use super::multisine::{Multisine, two_seconds};

/// A trajectory file. Lengths in m, angles in degrees where the name says so, altitudes above the
/// take-off floor, positions relative to the take-off point.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(tag = "family", rename_all = "kebab-case")]
pub(super) enum Family {
    /// One place, held.
    Hover(Hover),
    /// Two sinusoids, north and east, at one height.
    SinusoidXy(Sinusoid),
    /// Two sinusoids, north and down.
    SinusoidXz(Sinusoid),
    /// Two sinusoids, east and down.
    SinusoidYz(Sinusoid),
    /// Turning in place.
    YawRotation(YawRotation),
    /// Sinusoids in xy while turning: the paper's experiment.
    SinusoidYaw(SinusoidYaw),
    /// A figure of eight, flown along its length to the north.
    #[serde(rename = "figure-8")]
    FigureEight(FigureEight),
    /// Sums of sinusoids in position and yaw.
    Multisine(Multisine),
    /// Steps of position and yaw.
    Steps(Steps),
    /// Waypoints drawn in a box, flown in straight lines.
    RandomWaypoints(RandomWaypoints),
    /// Waypoints, flown in straight lines.
    Waypoints(Waypoints),
    /// A table of times and points.
    Csv(Csv),
    /// Waypoints and gates, flown as fast as the vehicle can: `downwash plan` finds when.
    TimeOptimal(TimeOptimal),
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Hover {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long it lasts.
    pub duration_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sinusoid {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long it lasts without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Of the plane's first and second axis.
    pub amplitude_m: [f64; 2],
    pub period_s: [f64; 2],
    /// At the start, of each.
    #[serde(default)]
    pub phase_deg: [f64; 2],
    /// How long it takes to come to full speed, and to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct YawRotation {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long it lasts without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Constant turning.
    #[serde(default)]
    pub yaw_rate_deg_s: f64,
    /// Swing on top of it.
    #[serde(default)]
    pub yaw_amplitude_deg: f64,
    /// Of the swing.
    #[serde(default = "four_seconds")]
    pub yaw_period_s: f64,
    /// How long it takes to come to full speed, and to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SinusoidYaw {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long it lasts without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    pub amplitude_m: f64,
    pub period_s: f64,
    /// Of the swing.
    pub yaw_period_s: f64,
    /// How long it takes to come to full speed, and to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FigureEight {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long it lasts without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Along north, from end to end.
    pub length_m: f64,
    /// Along east, from side to side.
    pub width_m: f64,
    pub period_s: f64,
    /// Gained by the middle of the period, and lost again.
    #[serde(default)]
    pub climb_m: f64,
    /// How long it takes to come to full speed, and to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Steps {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// How long each step is held.
    pub dwell_s: f64,
    /// North, east, up in m and yaw in degrees, relative to the hover point; each held for the
    /// dwell.
    pub offsets: Vec<[f64; 4]>,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RandomWaypoints {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// What the waypoints are drawn from.
    pub seed: u64,
    /// How many waypoints.
    pub count: usize,
    /// Of the box about the hover point: north, east, up.
    pub half_size_m: [f64; 3],
    /// How long a waypoint is held.
    #[serde(default)]
    pub hold_s: f64,
    /// How fast.
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Waypoints {
    /// In the order of flight.
    pub points: Vec<WaypointFields>,
    /// How fast.
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct PaceFields {
    /// Between waypoints.
    pub speed_m_s: f64,
    /// Out of a waypoint and into it.
    pub acceleration_m_s2: f64,
    /// While turning to the next yaw.
    pub yaw_rate_deg_s: f64,
}

impl Default for PaceFields {
    fn default() -> Self {
        Self { speed_m_s: 1.0, acceleration_m_s2: 1.0, yaw_rate_deg_s: 45.0 }
    }
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaypointFields {
    /// Relative to the take-off point.
    pub north_m: f64,
    /// Relative to the take-off point.
    pub east_m: f64,
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Clockwise from north, seen from above.
    #[serde(default)]
    pub yaw_deg: f64,
    /// How long a waypoint is held.
    #[serde(default)]
    pub hold_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Csv {
    /// Relative to the trajectory file.
    pub file: PathBuf,
}

/// Waypoints and gates, passed in order as fast as the vehicle can.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimeOptimal {
    /// Where it begins, level.
    pub start: StartFields,
    /// In the order of flight.
    #[serde(default)]
    pub passages: Vec<PassageFields>,
    /// Where it ends.
    pub finish: FinishFields,
    /// Narrower limits than those of the vehicle, of `[offboard.limits]` and of `[envelope]`.
    #[serde(default)]
    pub limits: LimitFields,
    /// What of the limits is kept back for feedback.
    #[serde(default)]
    pub margin: MarginFields,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StartFields {
    /// Relative to the take-off point.
    #[serde(default)]
    pub north_m: f64,
    /// Relative to the take-off point.
    #[serde(default)]
    pub east_m: f64,
    /// Height above the take-off floor.
    pub altitude_m: f64,
    /// Clockwise from north, seen from above.
    #[serde(default)]
    pub yaw_deg: f64,
    /// North, east, up.
    #[serde(default)]
    pub velocity_m_s: [f64; 3],
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FinishFields {
    /// Relative to the take-off point.
    #[serde(default)]
    pub north_m: f64,
    /// Relative to the take-off point.
    #[serde(default)]
    pub east_m: f64,
    /// Height above the take-off floor.
    pub altitude_m: f64,
    /// North, east, up.
    #[serde(default)]
    pub velocity_m_s: [f64; 3],
    /// Whether it ends level and without turning, as a vehicle that goes on hovering.
    #[serde(default = "yes")]
    pub level: bool,
}

/// Exactly one of the two is given.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum PassageFields {
    /// A ball that is touched.
    Waypoint(BallFields),
    /// An opening that is passed in one direction.
    Gate(GateFields),
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BallFields {
    /// Relative to the take-off point.
    pub north_m: f64,
    /// Relative to the take-off point.
    pub east_m: f64,
    /// Height above the take-off floor.
    pub altitude_m: f64,
    /// Distance at which it counts as passed.
    pub tolerance_m: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GateFields {
    /// Middle of the opening, relative to the take-off point.
    pub north_m: f64,
    /// Middle of the opening, relative to the take-off point.
    pub east_m: f64,
    /// Middle of the opening, above the take-off floor.
    pub altitude_m: f64,
    /// Direction of passage, clockwise from north.
    pub heading_deg: f64,
    /// Direction of passage, up from level.
    #[serde(default)]
    pub climb_deg: f64,
    /// Of the opening.
    pub width_m: f64,
    /// Of the opening.
    pub height_m: f64,
    /// Distance of the vehicle's centre from the frame, at least.
    #[serde(default)]
    pub clearance_m: f64,
}

#[derive(Debug, Default, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct LimitFields {
    /// Least and greatest thrust of each rotor, as shares of its greatest.
    pub rotor_thrust: Option<[f64; 2]>,
    /// About front, right and down.
    pub body_rate_deg_s: Option<[f64; 3]>,
    /// From level.
    pub tilt_deg: Option<f64>,
    /// Of flight.
    pub speed_m_s: Option<f64>,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct MarginFields {
    /// Share of each rotor's range that is left at either end.
    pub thrust: f64,
    /// Share of the body rates.
    pub body_rate: f64,
    /// Share of the tilt.
    pub tilt: f64,
}

impl Default for MarginFields {
    fn default() -> Self {
        Self { thrust: 0.1, body_rate: 0.2, tilt: 0.1 }
    }
}

fn yes() -> bool {
    true
}

fn four_seconds() -> f64 {
    4.0
}

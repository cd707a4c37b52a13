//! The content of a trajectory file.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Deserialize;

use super::multisine::{Multisine, two_seconds};

/// A trajectory file. Lengths in m, angles in degrees where the name says so, altitudes above the
/// take-off floor, positions relative to the take-off point.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(tag = "family", rename_all = "kebab-case")]
pub(super) enum Family {
    /// A constant position.
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
    /// Random waypoints in a box, flown in straight lines.
    RandomWaypoints(RandomWaypoints),
    /// Waypoints, flown in straight lines.
    Waypoints(Waypoints),
    /// A table of times and points.
    Csv(Csv),
    /// Waypoints and gates, flown in minimum time: `downwash plan` determines the times.
    TimeOptimal(TimeOptimal),
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Hover {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Duration.
    pub duration_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sinusoid {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Duration without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Amplitudes along the plane's first and second axis.
    pub amplitude_m: [f64; 2],
    pub period_s: [f64; 2],
    /// Phases at the start, along each axis.
    #[serde(default)]
    pub phase_deg: [f64; 2],
    /// Time to reach full speed, and to come to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct YawRotation {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Duration without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Constant part of the yaw rate.
    #[serde(default)]
    pub yaw_rate_deg_s: f64,
    /// Amplitude of the swing on top of it.
    #[serde(default)]
    pub yaw_amplitude_deg: f64,
    /// Period of the swing.
    #[serde(default = "four_seconds")]
    pub yaw_period_s: f64,
    /// Time to reach full speed, and to come to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SinusoidYaw {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Duration without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    pub amplitude_m: f64,
    pub period_s: f64,
    /// Time of one full turn in yaw.
    pub yaw_period_s: f64,
    /// Time to reach full speed, and to come to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FigureEight {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Duration without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Along north, from end to end.
    pub length_m: f64,
    /// Along east, from side to side.
    pub width_m: f64,
    pub period_s: f64,
    /// Height gained by the middle of the period, and lost again.
    #[serde(default)]
    pub climb_m: f64,
    /// Time to reach full speed, and to come to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Steps {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Time for which each step is held.
    pub dwell_s: f64,
    /// North, east, up in m and yaw in degrees, relative to the hover point; each is held for the
    /// dwell.
    pub offsets: Vec<[f64; 4]>,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RandomWaypoints {
    /// Height of the hover point above the take-off floor.
    pub altitude_m: f64,
    /// Seed of the random waypoints.
    pub seed: u64,
    /// Number of waypoints.
    pub count: usize,
    /// Half size of the box around the hover point: north, east, up.
    pub half_size_m: [f64; 3],
    /// Time at each waypoint.
    #[serde(default)]
    pub hold_s: f64,
    /// Speed, acceleration and yaw rate of the segments.
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Waypoints {
    /// Waypoints in the order of flight.
    pub points: Vec<WaypointFields>,
    /// Speed, acceleration and yaw rate of the segments.
    #[serde(default)]
    pub pace: PaceFields,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct PaceFields {
    /// Largest speed between waypoints.
    pub speed_m_s: f64,
    /// Largest acceleration out of a waypoint and into it.
    pub acceleration_m_s2: f64,
    /// Largest yaw rate while turning to the next yaw.
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
    /// Height above the take-off floor.
    pub altitude_m: f64,
    /// Clockwise from north, seen from above.
    #[serde(default)]
    pub yaw_deg: f64,
    /// Time at this waypoint.
    #[serde(default)]
    pub hold_s: f64,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Csv {
    /// Path of the table, relative to the trajectory file.
    pub file: PathBuf,
}

/// Waypoints and gates, passed in order in minimum time.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimeOptimal {
    /// The start; the vehicle is level there.
    pub start: StartFields,
    /// Waypoints and gates in the order of flight.
    #[serde(default)]
    pub passages: Vec<PassageFields>,
    /// The end of the flight.
    pub finish: FinishFields,
    /// Limits narrower than those of the vehicle, of `[offboard.limits]` and of `[envelope]`.
    #[serde(default)]
    pub limits: LimitFields,
    /// Fractions of the limits reserved for feedback.
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
    /// Whether the flight ends level and without rotation, for a vehicle that then hovers.
    #[serde(default = "yes")]
    pub level: bool,
}

/// Give exactly one of the two.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum PassageFields {
    /// A ball to touch.
    Waypoint(BallFields),
    /// An opening to pass in one direction.
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
    /// Distance from the centre at which it counts as passed.
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
    /// Width of the opening.
    pub width_m: f64,
    /// Height of the opening.
    pub height_m: f64,
    /// Least distance of the vehicle's centre from the frame.
    #[serde(default)]
    pub clearance_m: f64,
}

#[derive(Debug, Default, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct LimitFields {
    /// Least and greatest thrust of each rotor, as fractions of its greatest.
    pub rotor_thrust: Option<[f64; 2]>,
    /// Largest rates about front, right and down.
    pub body_rate_deg_s: Option<[f64; 3]>,
    /// Largest angle from level.
    pub tilt_deg: Option<f64>,
    /// Largest speed.
    pub speed_m_s: Option<f64>,
}

#[derive(Debug, JsonSchema, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct MarginFields {
    /// Fraction of each rotor's range reserved at either end.
    pub thrust: f64,
    /// Fraction of the body rates.
    pub body_rate: f64,
    /// Fraction of the tilt.
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

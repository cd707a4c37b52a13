//! The trajectory file: named families with parameters, waypoints, or a table.

use std::f64::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sitl::frame::Ned;

use super::curve::{Envelope, Harmonic, HarmonicCurve};
use super::multisine::Multisine;
use super::path::{MinimumJerkPath, Pace, Waypoint};
use super::table::Table;
use super::trajectory::{DesiredPoint, Shape, Trajectory};

/// Why a trajectory file is refused.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryError {
    /// The file cannot be read.
    #[error("trajectory {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text does not follow the schema.
    #[error("trajectory {path}: {message}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What was found and where.
        message: String,
    },
    /// A value is impossible.
    #[error("trajectory {path}: {field}: expected {expected}, found {found}")]
    Value {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: f64,
    },
}

/// A trajectory file. Lengths in m, angles in degrees where the name says so, altitudes above the
/// take-off floor, positions relative to the take-off point.
#[derive(Debug, Deserialize)]
#[serde(tag = "family", rename_all = "kebab-case")]
enum Family {
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
struct Hover {
    altitude_m: f64,
    duration_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sinusoid {
    altitude_m: f64,
    duration_s: f64,
    /// Of the plane's first and second axis.
    amplitude_m: [f64; 2],
    period_s: [f64; 2],
    #[serde(default)]
    phase_deg: [f64; 2],
    #[serde(default = "two_seconds")]
    ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct YawRotation {
    altitude_m: f64,
    duration_s: f64,
    /// Constant turning.
    #[serde(default)]
    yaw_rate_deg_s: f64,
    /// Swing on top of it.
    #[serde(default)]
    yaw_amplitude_deg: f64,
    #[serde(default = "four_seconds")]
    yaw_period_s: f64,
    #[serde(default = "two_seconds")]
    ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SinusoidYaw {
    altitude_m: f64,
    duration_s: f64,
    amplitude_m: f64,
    period_s: f64,
    yaw_period_s: f64,
    #[serde(default = "two_seconds")]
    ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FigureEight {
    altitude_m: f64,
    duration_s: f64,
    length_m: f64,
    width_m: f64,
    period_s: f64,
    #[serde(default)]
    climb_m: f64,
    #[serde(default = "two_seconds")]
    ramp_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Steps {
    altitude_m: f64,
    dwell_s: f64,
    /// North, east, up in m and yaw in degrees, relative to the hover point; each held for the dwell.
    offsets: Vec<[f64; 4]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RandomWaypoints {
    altitude_m: f64,
    seed: u64,
    count: usize,
    half_size_m: [f64; 3],
    #[serde(default)]
    hold_s: f64,
    #[serde(default)]
    pace: PaceFields,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Waypoints {
    points: Vec<WaypointFields>,
    #[serde(default)]
    pace: PaceFields,
}

#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct PaceFields {
    speed_m_s: f64,
    acceleration_m_s2: f64,
    yaw_rate_deg_s: f64,
}

impl Default for PaceFields {
    fn default() -> Self {
        Self { speed_m_s: 1.0, acceleration_m_s2: 1.0, yaw_rate_deg_s: 45.0 }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WaypointFields {
    north_m: f64,
    east_m: f64,
    altitude_m: f64,
    #[serde(default)]
    yaw_deg: f64,
    #[serde(default)]
    hold_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Csv {
    /// Relative to the trajectory file.
    file: PathBuf,
}

/// No flight lasts longer, s.
const DURATION_MAX_S: f64 = 86_400.0;

/// More random waypoints than this are a slip of the keyboard.
const WAYPOINTS_MAX: usize = 10_000;

pub(super) fn two_seconds() -> f64 {
    2.0
}
fn four_seconds() -> f64 {
    4.0
}

pub(super) fn load(path: &Path) -> Result<Trajectory, TrajectoryError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| TrajectoryError::Read { path: path.into(), source })?;
    if path.extension().is_some_and(|extension| extension == "csv") {
        let table = Table::parse(&text)
            .map_err(|message| TrajectoryError::Syntax { path: path.into(), message })?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        return Ok(Trajectory::new(name, Shape::Table(table)));
    }
    parse(&text, path)
}

pub(super) fn parse(text: &str, origin: &Path) -> Result<Trajectory, TrajectoryError> {
    let family: Family = toml::from_str(text).map_err(|error| TrajectoryError::Syntax {
        path: origin.into(),
        message: error.to_string(),
    })?;
    Builder { origin }.build(family)
}

/// Checks values on the way from file to shape; knows the file's name for the errors.
pub(super) struct Builder<'a> {
    origin: &'a Path,
}

impl Builder<'_> {
    fn build(&self, family: Family) -> Result<Trajectory, TrajectoryError> {
        let (name, shape) = match family {
            Family::Hover(f) => {
                let still = Harmonic::constant(0.0);
                let duration_s = self.positive("duration_s", f.duration_s)?;
                ("hover", self.harmonic([still; 2], f.altitude_m, still, duration_s, 0.0)?)
            }
            Family::SinusoidXy(f) => ("sinusoid-xy", self.sinusoid(&f, [0, 1])?),
            Family::SinusoidXz(f) => ("sinusoid-xz", self.sinusoid(&f, [0, 2])?),
            Family::SinusoidYz(f) => ("sinusoid-yz", self.sinusoid(&f, [1, 2])?),
            Family::YawRotation(f) => {
                let yaw = Harmonic {
                    amplitude: self.finite("yaw_amplitude_deg", f.yaw_amplitude_deg)?.to_radians(),
                    period_s: self.positive("yaw_period_s", f.yaw_period_s)?,
                    rate: self.finite("yaw_rate_deg_s", f.yaw_rate_deg_s)?.to_radians(),
                    ..Harmonic::default()
                };
                let still = Harmonic::constant(0.0);
                let shape = self.harmonic([still; 2], f.altitude_m, yaw, f.duration_s, f.ramp_s)?;
                ("yaw-rotation", shape)
            }
            Family::SinusoidYaw(f) => {
                let period_s = self.positive("period_s", f.period_s)?;
                let amplitude = self.finite("amplitude_m", f.amplitude_m)?;
                // north = A sin(w t), east = A (1 - cos(w t)): a circle that starts at the anchor.
                let north = Harmonic { amplitude, period_s, ..Harmonic::default() };
                let east = Harmonic { phase: -FRAC_PI_2, ..north };
                let yaw_period_s = self.positive("yaw_period_s", f.yaw_period_s)?;
                let yaw = Harmonic {
                    rate: std::f64::consts::TAU / yaw_period_s,
                    ..Harmonic::constant(0.0)
                };
                let shape =
                    self.harmonic([north, east], f.altitude_m, yaw, f.duration_s, f.ramp_s)?;
                ("sinusoid-yaw", shape)
            }
            Family::FigureEight(f) => {
                let period_s = self.positive("period_s", f.period_s)?;
                let north = Harmonic {
                    amplitude: 0.5 * self.finite("length_m", f.length_m)?,
                    period_s,
                    ..Harmonic::default()
                };
                let east = Harmonic {
                    amplitude: 0.5 * self.finite("width_m", f.width_m)?,
                    period_s: 0.5 * period_s,
                    ..Harmonic::default()
                };
                let mut shape = self.harmonic(
                    [north, east],
                    f.altitude_m,
                    Harmonic::constant(0.0),
                    f.duration_s,
                    f.ramp_s,
                )?;
                if let Shape::Harmonic { curve, .. } = &mut shape {
                    // climb/2 (1 - cos): up from the given altitude and back.
                    curve.position[2].push(Harmonic {
                        amplitude: -0.5 * self.finite("climb_m", f.climb_m)?,
                        period_s,
                        phase: -FRAC_PI_2,
                        ..Harmonic::default()
                    });
                }
                ("figure-8", shape)
            }
            Family::Multisine(f) => ("multisine", f.shape(self)?),
            Family::Steps(f) => ("steps", self.steps(&f)?),
            Family::RandomWaypoints(f) => {
                let half_size = [
                    self.at_least_zero("half_size_m", f.half_size_m[0])?,
                    self.at_least_zero("half_size_m", f.half_size_m[1])?,
                    self.at_least_zero("half_size_m", f.half_size_m[2])?,
                ];
                let centre = Ned::new(0.0, 0.0, -self.positive("altitude_m", f.altitude_m)?);
                let hold_s = self.at_least_zero("hold_s", f.hold_s)?;
                let few = f.count <= WAYPOINTS_MAX;
                self.check("count", "at most 10000 waypoints", f.count as f64, few)?;
                let pace = self.pace(&f.pace)?;
                let path =
                    MinimumJerkPath::random(f.seed, f.count, centre, half_size, hold_s, pace);
                ("random-waypoints", Shape::Path(self.some_points(path)?))
            }
            Family::Waypoints(f) => {
                let mut waypoints = Vec::new();
                for point in &f.points {
                    waypoints.push(Waypoint {
                        position: Ned::new(
                            self.finite("north_m", point.north_m)?,
                            self.finite("east_m", point.east_m)?,
                            -self.positive("altitude_m", point.altitude_m)?,
                        ),
                        yaw: self.finite("yaw_deg", point.yaw_deg)?.to_radians(),
                        hold_s: self.at_least_zero("hold_s", point.hold_s)?,
                    });
                }
                let path = MinimumJerkPath::through(&waypoints, self.pace(&f.pace)?);
                ("waypoints", Shape::Path(self.some_points(path)?))
            }
            Family::Csv(f) => {
                let folder = self.origin.parent().unwrap_or(Path::new("."));
                return load(&folder.join(f.file).with_extension("csv"));
            }
        };
        let trajectory = Trajectory::new(name, shape);
        let duration = trajectory.duration();
        self.check(
            "duration",
            "more than 0 and at most a day, in s",
            duration,
            duration > 0.0 && duration <= DURATION_MAX_S,
        )?;
        Ok(trajectory)
    }

    fn harmonic(
        &self,
        [north, east]: [Harmonic; 2],
        altitude_m: f64,
        yaw: Harmonic,
        duration_s: f64,
        ramp_s: f64,
    ) -> Result<Shape, TrajectoryError> {
        let down = Harmonic::constant(-self.positive("altitude_m", altitude_m)?);
        let envelope = Envelope::new(
            self.positive("duration_s", duration_s)?,
            self.at_least_zero("ramp_s", ramp_s)?,
        );
        let curve = HarmonicCurve::of_one([north, east, down], yaw);
        Ok(Shape::Harmonic { curve, envelope })
    }

    fn sinusoid(&self, f: &Sinusoid, axes: [usize; 2]) -> Result<Shape, TrajectoryError> {
        let mut position = [Harmonic::constant(0.0); 3];
        position[2].offset = -self.positive("altitude_m", f.altitude_m)?;
        for (index, axis) in axes.into_iter().enumerate() {
            position[axis] = Harmonic {
                amplitude: self.finite("amplitude_m", f.amplitude_m[index])?,
                period_s: self.positive("period_s", f.period_s[index])?,
                phase: self.finite("phase_deg", f.phase_deg[index])?.to_radians(),
                ..position[axis]
            };
        }
        let envelope = Envelope::new(
            self.positive("duration_s", f.duration_s)?,
            self.at_least_zero("ramp_s", f.ramp_s)?,
        );
        let curve = HarmonicCurve::of_one(position, Harmonic::constant(0.0));
        Ok(Shape::Harmonic { curve, envelope })
    }

    fn steps(&self, f: &Steps) -> Result<Shape, TrajectoryError> {
        let hover = -self.positive("altitude_m", f.altitude_m)?;
        let dwell_s = self.positive("dwell_s", f.dwell_s)?;
        // It starts with a dwell at the hover point, so that the first step is seen whole.
        let still = DesiredPoint { position: Ned::new(0.0, 0.0, hover), ..Default::default() };
        let mut points = vec![still];
        for offset in &f.offsets {
            for value in offset {
                self.finite("offsets", *value)?;
            }
            let [north, east, up, yaw_deg] = *offset;
            points.push(DesiredPoint {
                position: Ned::new(north, east, hover - up),
                yaw: yaw_deg.to_radians(),
                ..still
            });
        }
        Ok(Shape::Steps { points, dwell_s })
    }

    fn pace(&self, fields: &PaceFields) -> Result<Pace, TrajectoryError> {
        Ok(Pace {
            speed: self.positive("speed_m_s", fields.speed_m_s)?,
            acceleration: self.positive("acceleration_m_s2", fields.acceleration_m_s2)?,
            yaw_rate: self.positive("yaw_rate_deg_s", fields.yaw_rate_deg_s)?.to_radians(),
        })
    }

    fn some_points(
        &self,
        path: Option<MinimumJerkPath>,
    ) -> Result<MinimumJerkPath, TrajectoryError> {
        path.ok_or_else(|| self.wrong("points", "at least one waypoint", 0.0))
    }

    pub(super) fn finite(&self, field: &'static str, found: f64) -> Result<f64, TrajectoryError> {
        self.check(field, "a finite number", found, found.is_finite())
    }

    pub(super) fn positive(&self, field: &'static str, found: f64) -> Result<f64, TrajectoryError> {
        self.check(field, "a finite number above 0", found, found.is_finite() && found > 0.0)
    }

    pub(super) fn at_least_zero(
        &self,
        field: &'static str,
        found: f64,
    ) -> Result<f64, TrajectoryError> {
        self.check(field, "a finite number of at least 0", found, found.is_finite() && found >= 0.0)
    }

    fn check(
        &self,
        field: &'static str,
        expected: &'static str,
        found: f64,
        right: bool,
    ) -> Result<f64, TrajectoryError> {
        if right { Ok(found) } else { Err(self.wrong(field, expected, found)) }
    }

    fn wrong(&self, field: &'static str, expected: &'static str, found: f64) -> TrajectoryError {
        TrajectoryError::Value { path: self.origin.into(), field, expected, found }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_text(text: &str) -> Result<Trajectory, TrajectoryError> {
        parse(text, Path::new("test.toml"))
    }

    #[test]
    fn sinusoid_yaw_is_the_papers_curve() {
        let text = "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 20\namplitude_m = 1\nperiod_s = 5\nyaw_period_s = 10\nramp_s = 2";
        let trajectory = parse_text(text).expect("a trajectory");
        assert_eq!(trajectory.duration(), 22.0);
        // Phase time 1.25 s (a quarter of the period) is reached half a ramp later.
        let quarter = trajectory.sample(1.25 + 1.0);
        assert!((quarter.position - Ned::new(1.0, 1.0, -1.0)).norm() < 1e-9);
        assert!((quarter.yaw_rate - std::f64::consts::TAU / 10.0).abs() < 1e-12);
        assert_eq!(trajectory.sample(0.0).velocity.norm(), 0.0);
    }

    #[test]
    fn unknown_families_and_keys_are_refused_by_name() {
        let error = |text| parse_text(text).expect_err("refused").to_string();
        assert!(error("family = 'loop'").contains("loop"));
        assert!(
            error("family = 'hover'\naltitude_m = 1\nduration_s = 3\nspeed = 2").contains("speed")
        );
        assert!(error("family = 'hover'\naltitude_m = nan\nduration_s = 3").contains("altitude_m"));
        assert!(error("family = 'hover'\naltitude_m = 1\nduration_s = -3").contains("duration_s"));
        assert!(
            error("family = 'random-waypoints'\naltitude_m = 1\nseed = 1\ncount = 2\nhalf_size_m = [1,1,1]\npace = {speeed_m_s = 2}")
                .contains("speeed_m_s")
        );
    }

    #[test]
    fn every_shipped_file_parses() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/trajectories");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).expect("the folder") {
            let path = entry.expect("an entry").path();
            let trajectory = load(&path).expect("a trajectory");
            assert!(trajectory.duration() > 1.0, "{}", path.display());
            count += 1;
        }
        assert!(count >= 10);
    }
}

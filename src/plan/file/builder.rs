//! Converts the content of a trajectory file to a trajectory, with every value checked.

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use vehicle::frame::Ned;

use super::family::{
    Family, FigureEight, PaceFields, RandomWaypoints, Sinusoid, SinusoidYaw, Steps, Waypoints,
    YawRotation,
};
use super::multisine::Multisine;
use super::{DURATION_MAX_S, TrajectoryError, TrajectoryFile, load_table};
use crate::plan::curve::{Envelope, Harmonic, HarmonicCurve};
use crate::plan::path::{MinimumJerkPath, Pace, Waypoint};
use crate::plan::trajectory::{DesiredPoint, Shape, Trajectory};

/// Most random waypoints; a larger count is a typing error.
const WAYPOINTS_MAX: usize = 10_000;

/// Checks values during the conversion; holds the file's name for errors.
pub(super) struct Builder<'a> {
    pub(super) origin: &'a Path,
}

impl Builder<'_> {
    pub(super) fn build(&self, family: Family) -> Result<TrajectoryFile, TrajectoryError> {
        let (name, shape) = match family {
            Family::Hover(f) => {
                let still = Harmonic::constant(0.0);
                let duration_s = self.positive("duration_s", f.duration_s)?;
                ("hover", self.harmonic([still; 2], f.altitude_m, still, duration_s, 0.0)?)
            }
            Family::SinusoidXy(f) => ("sinusoid-xy", self.sinusoid(&f, [0, 1])?),
            Family::SinusoidXz(f) => ("sinusoid-xz", self.sinusoid(&f, [0, 2])?),
            Family::SinusoidYz(f) => ("sinusoid-yz", self.sinusoid(&f, [1, 2])?),
            Family::YawRotation(f) => ("yaw-rotation", self.yaw_rotation(&f)?),
            Family::SinusoidYaw(f) => ("sinusoid-yaw", self.sinusoid_yaw(&f)?),
            Family::FigureEight(f) => ("figure-8", self.figure_eight(&f)?),
            Family::Multisine(f) => ("multisine", self.multisine(&f)?),
            Family::Steps(f) => ("steps", self.steps(&f)?),
            Family::RandomWaypoints(f) => ("random-waypoints", self.random_waypoints(&f)?),
            Family::Waypoints(f) => ("waypoints", self.waypoints(&f)?),
            Family::Csv(f) => {
                let folder = self.origin.parent().unwrap_or(Path::new("."));
                let mut path = folder.join(f.file);
                if path.extension().is_none() {
                    path.set_extension("csv");
                }
                return load_table(&path);
            }
            Family::TimeOptimal(f) => return Ok(TrajectoryFile::Task(self.task(&f)?)),
        };
        let trajectory = Trajectory::new(name, shape);
        let duration = trajectory.duration();
        self.check(
            "duration",
            "more than 0 and at most a day, in s",
            duration,
            duration > 0.0 && duration <= DURATION_MAX_S,
        )?;
        Ok(TrajectoryFile::Desired(trajectory))
    }

    fn yaw_rotation(&self, f: &YawRotation) -> Result<Shape, TrajectoryError> {
        let yaw = Harmonic {
            amplitude: self.finite("yaw_amplitude_deg", f.yaw_amplitude_deg)?.to_radians(),
            period_s: self.positive("yaw_period_s", f.yaw_period_s)?,
            rate: self.finite("yaw_rate_deg_s", f.yaw_rate_deg_s)?.to_radians(),
            ..Harmonic::default()
        };
        let still = Harmonic::constant(0.0);
        self.harmonic([still; 2], f.altitude_m, yaw, f.duration_s, f.ramp_s)
    }

    fn sinusoid_yaw(&self, f: &SinusoidYaw) -> Result<Shape, TrajectoryError> {
        let period_s = self.positive("period_s", f.period_s)?;
        let amplitude = self.finite("amplitude_m", f.amplitude_m)?;
        // north = A sin(w t), east = A (1 - cos(w t)): a circle that starts at the anchor.
        let north = Harmonic { amplitude, period_s, ..Harmonic::default() };
        let east = Harmonic { phase: -FRAC_PI_2, ..north };
        let yaw_period_s = self.positive("yaw_period_s", f.yaw_period_s)?;
        let yaw =
            Harmonic { rate: std::f64::consts::TAU / yaw_period_s, ..Harmonic::constant(0.0) };
        self.harmonic([north, east], f.altitude_m, yaw, f.duration_s, f.ramp_s)
    }

    fn figure_eight(&self, f: &FigureEight) -> Result<Shape, TrajectoryError> {
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
        Ok(shape)
    }

    fn random_waypoints(&self, f: &RandomWaypoints) -> Result<Shape, TrajectoryError> {
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
        let path = MinimumJerkPath::random(f.seed, f.count, centre, half_size, hold_s, pace);
        Ok(Shape::Path(self.some_points(path)?))
    }

    fn waypoints(&self, f: &Waypoints) -> Result<Shape, TrajectoryError> {
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
        Ok(Shape::Path(self.some_points(path)?))
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

    fn multisine(&self, f: &Multisine) -> Result<Shape, TrajectoryError> {
        self.positive("altitude_m", f.altitude_m)?;
        for offset in f.offset_m {
            self.finite("offset_m", offset)?;
        }
        self.finite("heading_deg", f.heading_deg)?;
        self.finite("yaw_rate_deg_s", f.yaw_rate_deg_s)?;
        self.positive("duration_s", f.duration_s)?;
        self.at_least_zero("ramp_s", f.ramp_s)?;
        for wave in [&f.north, &f.east, &f.up].into_iter().flatten() {
            self.finite("amplitude_m", wave.amplitude_m)?;
            self.positive("period_s", wave.period_s)?;
            self.finite("phase_deg", wave.phase_deg)?;
        }
        for wave in &f.yaw {
            self.finite("amplitude_deg", wave.amplitude_deg)?;
            self.positive("period_s", wave.period_s)?;
            self.finite("phase_deg", wave.phase_deg)?;
        }
        Ok(f.shape())
    }

    fn steps(&self, f: &Steps) -> Result<Shape, TrajectoryError> {
        let hover = -self.positive("altitude_m", f.altitude_m)?;
        let dwell_s = self.positive("dwell_s", f.dwell_s)?;
        // The first dwell is at the hover point, so that the whole first step can be observed.
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

    pub(super) fn check(
        &self,
        field: &'static str,
        expected: &'static str,
        found: f64,
        right: bool,
    ) -> Result<f64, TrajectoryError> {
        if right { Ok(found) } else { Err(self.wrong(field, expected, found)) }
    }

    pub(super) fn wrong(
        &self,
        field: &'static str,
        expected: &'static str,
        found: f64,
    ) -> TrajectoryError {
        TrajectoryError::Value { path: self.origin.into(), field, expected, found }
    }
}

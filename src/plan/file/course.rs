//! Converts a time-optimal trajectory file to a task, with every value checked.

use std::f64::consts::{FRAC_PI_2, PI};

use vehicle::frame::Ned;

use super::TrajectoryError;
use super::builder::Builder;
use super::family::{
    BallFields, GateFields, LimitFields, MarginFields, PassageFields, TimeOptimal,
};
use crate::plan::time_optimal::{Finish, Gate, Margin, Passage, Start, Task, Wishes};

/// Most passages; a larger count is a typing error.
const PASSAGES_MAX: usize = 1000;
/// Places closer than this count as one, m.
const APART_M: f64 = 1e-3;

impl Builder<'_> {
    pub(super) fn task(&self, f: &TimeOptimal) -> Result<Task, TrajectoryError> {
        let few = f.passages.len() <= PASSAGES_MAX;
        self.check("passages", "at most 1000 of them", f.passages.len() as f64, few)?;
        let start = Start {
            position: self.place(f.start.north_m, f.start.east_m, f.start.altitude_m)?,
            velocity: self.velocity(f.start.velocity_m_s)?,
            yaw: self.finite("yaw_deg", f.start.yaw_deg)?.to_radians(),
        };
        let finish = Finish {
            position: self.place(f.finish.north_m, f.finish.east_m, f.finish.altitude_m)?,
            velocity: self.velocity(f.finish.velocity_m_s)?,
            is_level: f.finish.level,
        };
        let mut passages = Vec::new();
        for passage in &f.passages {
            passages.push(match passage {
                PassageFields::Waypoint(ball) => self.ball(ball)?,
                PassageFields::Gate(gate) => Passage::Gate(self.gate(gate)?),
            });
        }
        let task = Task {
            name: "time-optimal".to_owned(),
            start,
            passages,
            finish,
            wishes: self.wishes(&f.limits)?,
            margin: self.margin(&f.margin)?,
        };
        self.check_apart(&task)?;
        Ok(task)
    }

    /// Whether every place differs from the previous one.
    fn check_apart(&self, task: &Task) -> Result<(), TrajectoryError> {
        let places = task.places();
        for pair in places.windows(2) {
            let [(before, from, _), (name, to, _)] = pair else { continue };
            if (*to - *from).norm() < APART_M {
                let message = format!(
                    "{name} is at the same place as {before}; expected at least {APART_M} m \
                     between one place and the next"
                );
                return Err(TrajectoryError::Syntax { path: self.origin.into(), message });
            }
        }
        Ok(())
    }

    fn place(&self, north: f64, east: f64, altitude: f64) -> Result<Ned, TrajectoryError> {
        Ok(Ned::new(
            self.finite("north_m", north)?,
            self.finite("east_m", east)?,
            -self.positive("altitude_m", altitude)?,
        ))
    }

    fn velocity(&self, velocity: [f64; 3]) -> Result<Ned, TrajectoryError> {
        for part in velocity {
            self.finite("velocity_m_s", part)?;
        }
        let [north, east, up] = velocity;
        Ok(Ned::new(north, east, -up))
    }

    fn ball(&self, f: &BallFields) -> Result<Passage, TrajectoryError> {
        Ok(Passage::Waypoint {
            centre: self.place(f.north_m, f.east_m, f.altitude_m)?,
            tolerance_m: self.positive("tolerance_m", f.tolerance_m)?,
        })
    }

    fn gate(&self, f: &GateFields) -> Result<Gate, TrajectoryError> {
        let heading = self.finite("heading_deg", f.heading_deg)?.to_radians();
        let climb = self.finite("climb_deg", f.climb_deg)?.to_radians();
        let expected = "-90 to 90 degrees";
        self.check("climb_deg", expected, f.climb_deg, climb.abs() <= FRAC_PI_2)?;
        let clearance = self.at_least_zero("clearance_m", f.clearance_m)?;
        let mut opening = [0.0; 2];
        let sizes = [("width_m", f.width_m), ("height_m", f.height_m)];
        for (size, (field, found)) in opening.iter_mut().zip(sizes) {
            *size = self.positive(field, found)? - 2.0 * clearance;
            let expected = "more than twice the clearance_m";
            self.check(field, expected, found, *size > 0.0)?;
        }
        let centre = self.place(f.north_m, f.east_m, f.altitude_m)?;
        Ok(Gate::new(centre, heading, climb, opening))
    }

    fn wishes(&self, f: &LimitFields) -> Result<Wishes, TrajectoryError> {
        if let Some([least, most]) = f.rotor_thrust {
            let expected = "shares of 0 to 1, the first below the second";
            let is_range = (0.0..=1.0).contains(&least) && most <= 1.0 && least < most;
            self.check("rotor_thrust", expected, if is_range { least } else { most }, is_range)?;
        }
        for rate in f.body_rate_deg_s.iter().flatten() {
            self.positive("body_rate_deg_s", *rate)?;
        }
        if let Some(tilt) = f.tilt_deg {
            let is_tilt = tilt > 0.0 && tilt.to_radians() < PI;
            self.check("tilt_deg", "more than 0 and less than 180", tilt, is_tilt)?;
        }
        if let Some(speed) = f.speed_m_s {
            self.positive("speed_m_s", speed)?;
        }
        Ok(Wishes {
            rotor: f.rotor_thrust,
            body_rate_rad_s: f.body_rate_deg_s.map(|rates| rates.map(f64::to_radians)),
            tilt_rad: f.tilt_deg.map(f64::to_radians),
            speed_m_s: f.speed_m_s,
        })
    }

    fn margin(&self, f: &MarginFields) -> Result<Margin, TrajectoryError> {
        let share = |field, found: f64, most: f64| {
            self.check(
                field,
                "a share of at least 0 and less than a half",
                found,
                (0.0..most).contains(&found),
            )
        };
        Ok(Margin {
            thrust: share("thrust", f.thrust, 0.5)?,
            body_rate: share("body_rate", f.body_rate, 0.5)?,
            tilt: share("tilt", f.tilt, 0.5)?,
        })
    }
}

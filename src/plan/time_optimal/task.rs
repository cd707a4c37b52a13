//! A time-optimal trajectory file's wish, before it is known what flies it.

use vehicle::frame::Ned;

use super::course::{Course, Finish, Margin, Passage, Start};
use crate::plan::keep_out::KeepOut;

/// What of the limits a task narrows further.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wishes {
    /// Least and greatest thrust of each rotor, as a share of its largest.
    pub rotor: Option<[f64; 2]>,
    /// Greatest body rate about front, right and down, rad/s.
    pub body_rate_rad_s: Option<[f64; 3]>,
    /// Greatest tilt, rad.
    pub tilt_rad: Option<f64>,
    /// m/s
    pub speed_m_s: Option<f64>,
}

/// Where to fly as fast as it goes, with what of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// What it is called in logs and reports.
    pub name: String,
    /// Where it begins.
    pub start: Start,
    /// In the order of flight.
    pub passages: Vec<Passage>,
    /// Where it ends.
    pub finish: Finish,
    /// Narrower limits.
    pub wishes: Wishes,
    /// What is kept back for feedback.
    pub margin: Margin,
}

/// Why no way can lead through a course.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoWay {
    /// A place that must be passed is where the vehicle must not be.
    #[error(
        "{place} lies in keep_out[{region}] of [plan] in the configuration: no way leads through it"
    )]
    KeptOut {
        /// What lies there.
        place: String,
        /// The number of the region, from 0.
        region: usize,
    },
    /// A place that must be passed is out of the box.
    #[error("{place} lies out of box_m of [plan] in the configuration: no way leads through it")]
    OutOfBox {
        /// What lies there.
        place: String,
    },
}

impl Task {
    /// The course with regions to keep out of and a room to stay in.
    ///
    /// # Errors
    /// A place that cannot be reached.
    pub fn course(
        &self,
        keep_out: Vec<KeepOut>,
        room: Option<(Ned, Ned)>,
    ) -> Result<Course, NoWay> {
        for (name, place, tolerance) in self.places() {
            for (number, region) in keep_out.iter().enumerate() {
                if region.depth(place.to_array()).0 > tolerance {
                    return Err(NoWay::KeptOut { place: name, region: number });
                }
            }
            if let Some((lower, upper)) = room {
                let beyond =
                    (lower - place).to_array().into_iter().chain((place - upper).to_array());
                if beyond.fold(f64::MIN, f64::max) > tolerance {
                    return Err(NoWay::OutOfBox { place: name });
                }
            }
        }
        Ok(Course {
            start: self.start,
            passages: self.passages.clone(),
            finish: self.finish,
            keep_out,
            room,
        })
    }

    /// The places with their names in the file, and how far from them the vehicle may pass, m.
    pub fn places(&self) -> Vec<(String, Ned, f64)> {
        let mut places = vec![("start".to_owned(), self.start.position, 0.0)];
        for (number, passage) in self.passages.iter().enumerate() {
            let room = match passage {
                Passage::Waypoint { tolerance_m, .. } => *tolerance_m,
                Passage::Gate(gate) => gate.half_width_m.hypot(gate.half_height_m),
            };
            places.push((format!("passages[{number}]"), passage.centre(), room));
        }
        places.push(("finish".to_owned(), self.finish.position, 0.0));
        places
    }
}

//! The content of a time-optimal trajectory file, independent of the vehicle.

use vehicle::frame::Ned;

use super::course::{Course, Finish, Margin, Passage, Start};
use crate::plan::flight_box::FlightBox;
use crate::plan::keep_out::KeepOut;

/// Limits that a task narrows further.
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

/// A minimum-time flight, and the part of the vehicle's limits that it may use.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Its name in logs and reports.
    pub name: String,
    /// State at the start.
    pub start: Start,
    /// Passages in the order of flight.
    pub passages: Vec<Passage>,
    /// State at the end.
    pub finish: Finish,
    /// Narrower limits.
    pub wishes: Wishes,
    /// Fractions of the limits reserved for feedback.
    pub margin: Margin,
}

/// Why no path can lead through a course.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoWay {
    /// A place to pass is inside a region to avoid.
    #[error(
        "{place} is inside keep_out[{region}] of [plan] in the configuration: no path can pass it"
    )]
    KeptOut {
        /// The place.
        place: String,
        /// The index of the region, from 0.
        region: usize,
    },
    /// A place to pass is outside the box.
    #[error("{place} is outside box_m of [plan] in the configuration: no path can pass it")]
    OutOfBox {
        /// The place.
        place: String,
    },
}

impl Task {
    /// The course with the regions to avoid and the box that bounds the flight.
    ///
    /// # Errors
    /// A place cannot be reached.
    pub fn course(&self, keep_out: Vec<KeepOut>, room: Option<FlightBox>) -> Result<Course, NoWay> {
        for (name, place, tolerance) in self.places() {
            for (number, region) in keep_out.iter().enumerate() {
                if region.depth(place.to_array()).0 > tolerance {
                    return Err(NoWay::KeptOut { place: name, region: number });
                }
            }
            if room.is_some_and(|room| room.outside_m(place) > tolerance) {
                return Err(NoWay::OutOfBox { place: name });
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

    /// The places with their names in the file, and the distance at which the vehicle may pass
    /// them, m.
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

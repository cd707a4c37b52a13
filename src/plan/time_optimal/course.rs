//! The course of a minimum-time flight: places to pass in order, from a start to a finish.

use vehicle::frame::Ned;

use crate::plan::flight_box::FlightBox;
use crate::plan::keep_out::KeepOut;

/// A place to pass at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Passage {
    /// A ball to touch.
    Waypoint {
        /// m
        centre: Ned,
        /// m
        tolerance_m: f64,
    },
    /// An opening in a plane, passed in the direction of its normal.
    Gate(Gate),
}

impl Passage {
    /// The position of its centre, m.
    pub fn centre(&self) -> Ned {
        match self {
            Self::Waypoint { centre, .. } => *centre,
            Self::Gate(gate) => gate.centre,
        }
    }
}

/// A rectangular opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Middle of the opening, m.
    pub centre: Ned,
    /// Unit vector of the direction of passage.
    pub normal: Ned,
    /// Unit vector along the opening's width.
    pub side: Ned,
    /// Half of the width available to the vehicle's centre, m.
    pub half_width_m: f64,
    /// Half of the height available to the vehicle's centre, m.
    pub half_height_m: f64,
}

impl Gate {
    /// An opening of this width and height, m, passed along a heading from north and a climb from
    /// level, rad; its width is level.
    pub fn new(centre: Ned, heading: f64, climb: f64, [width_m, height_m]: [f64; 2]) -> Self {
        let ((sin, cos), (up, level)) = (heading.sin_cos(), climb.sin_cos());
        Self {
            centre,
            normal: Ned::new(level * cos, level * sin, -up),
            side: Ned::new(-sin, cos, 0.0),
            half_width_m: 0.5 * width_m,
            half_height_m: 0.5 * height_m,
        }
    }

    /// Unit vector along the opening's height: down if the gate is upright.
    pub fn down(&self) -> Ned {
        self.normal.cross(self.side)
    }
}

/// State at the start of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// m
    pub position: Ned,
    /// m/s
    pub velocity: Ned,
    /// Heading from north, rad. The vehicle is level there and does not rotate.
    pub yaw: f64,
}

/// State at the end of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// m
    pub position: Ned,
    /// m/s
    pub velocity: Ned,
    /// Whether the vehicle must be level and not rotate there, as if it then hovers.
    pub is_level: bool,
}

/// A course with its obstacles.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// State at the start.
    pub start: Start,
    /// Passages in the order of flight.
    pub passages: Vec<Passage>,
    /// State at the end.
    pub finish: Finish,
    /// Regions to avoid.
    pub keep_out: Vec<KeepOut>,
    /// The box that bounds the flight.
    pub room: Option<FlightBox>,
}

impl Course {
    /// The start, the centres of the passages, and the finish, m.
    pub(super) fn places(&self) -> Vec<Ned> {
        let mut places = vec![self.start.position];
        places.extend(self.passages.iter().map(Passage::centre));
        places.push(self.finish.position);
        places
    }
}

/// Limits on the use of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Least and greatest thrust of each rotor, as a share of its largest.
    pub rotor: [f64; 2],
    /// Greatest body rate about front, right and down, rad/s.
    pub body_rate_rad_s: [f64; 3],
    /// Greatest rate of the yaw angle, rad/s.
    pub yaw_rate_rad_s: Option<f64>,
    /// Greatest angle between the body's down and the world's, rad.
    pub tilt_rad: Option<f64>,
    /// m/s
    pub speed_m_s: Option<f64>,
}

/// Fractions of the limits that are reserved for feedback.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Margin {
    /// Of each rotor's range, at either end.
    pub thrust: f64,
    /// Of the body rates.
    pub body_rate: f64,
    /// Of the tilt.
    pub tilt: f64,
}

impl Limits {
    /// The limits less a margin.
    pub fn less(self, margin: &Margin) -> Self {
        let [least, most] = self.rotor;
        let kept = margin.thrust * (most - least);
        Self {
            rotor: [least + kept, most - kept],
            body_rate_rad_s: self.body_rate_rad_s.map(|rate| rate * (1.0 - margin.body_rate)),
            yaw_rate_rad_s: self.yaw_rate_rad_s.map(|rate| rate * (1.0 - margin.body_rate)),
            tilt_rad: self.tilt_rad.map(|tilt| tilt * (1.0 - margin.tilt)),
            ..self
        }
    }
}

//! What is flown as fast as it goes: places that are passed in order, from a start to a finish.

use vehicle::frame::Ned;

use crate::plan::keep_out::KeepOut;

/// What is passed at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Passage {
    /// A ball that is touched.
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
    /// Its middle, m.
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
    /// Unit vector that the gate is passed along.
    pub normal: Ned,
    /// Unit vector along the opening's width.
    pub side: Ned,
    /// Half of the width that the vehicle's centre has, m.
    pub half_width_m: f64,
    /// Half of the height that the vehicle's centre has, m.
    pub half_height_m: f64,
}

impl Gate {
    /// An opening of this width and height, m, that is passed along a heading from north and a
    /// climb from level, rad; its width is level.
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

    /// Unit vector along the opening's height: down where the gate is upright.
    pub fn down(&self) -> Ned {
        self.normal.cross(self.side)
    }
}

/// Where the flight begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// m
    pub position: Ned,
    /// m/s
    pub velocity: Ned,
    /// Heading from north, rad. The vehicle is level there and does not turn.
    pub yaw: f64,
}

/// Where the flight ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// m
    pub position: Ned,
    /// m/s
    pub velocity: Ned,
    /// Whether the vehicle is to be level and not to turn there, as one that goes on hovering.
    pub is_level: bool,
}

/// A course.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// Where it begins.
    pub start: Start,
    /// In the order of flight.
    pub passages: Vec<Passage>,
    /// Where it ends.
    pub finish: Finish,
    /// Regions to keep out of.
    pub keep_out: Vec<KeepOut>,
    /// Least and greatest corner of the box to stay in, m.
    pub room: Option<(Ned, Ned)>,
}

/// What of the vehicle may be used.
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

/// What of the limits is kept back for feedback, each as a share of the limit.
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
    /// What a margin leaves of them.
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

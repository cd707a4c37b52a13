//! Axes that tables use, and their conversion to NED and FRD.

use serde::Deserialize;
use sitl::frame::{Attitude, Frd, Ned};

/// Axes of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldFrame {
    /// North, east, down.
    Ned,
    /// East, north, up.
    Enu,
    /// North (or any horizontal x), west (left of x), up: most motion capture.
    Nwu,
}

/// Axes of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyFrame {
    /// Front, right, down.
    Frd,
    /// Front, left, up.
    Flu,
}

/// Half a turn about the first axis, which maps left and up to right and down.
const HALF_TURN_X: Attitude = Attitude { w: 0.0, x: 1.0, y: 0.0, z: 0.0 };
/// Half a turn about the middle of the first two axes, which maps east, north, up to north, east,
/// down.
const HALF_TURN_XY: Attitude = Attitude {
    w: 0.0,
    x: std::f64::consts::FRAC_1_SQRT_2,
    y: std::f64::consts::FRAC_1_SQRT_2,
    z: 0.0,
};

impl WorldFrame {
    /// A vector in these axes.
    pub fn to_ned(self, [x, y, z]: [f64; 3]) -> Ned {
        match self {
            Self::Ned => Ned::new(x, y, z),
            Self::Enu => Ned::new(y, x, -z),
            Self::Nwu => Ned::new(x, -y, -z),
        }
    }

    fn half_turn(self) -> Option<Attitude> {
        match self {
            Self::Ned => None,
            Self::Enu => Some(HALF_TURN_XY),
            Self::Nwu => Some(HALF_TURN_X),
        }
    }
}

impl BodyFrame {
    /// A vector in these axes.
    pub fn to_frd(self, [x, y, z]: [f64; 3]) -> Frd {
        match self {
            Self::Frd => Frd::new(x, y, z),
            Self::Flu => Frd::new(x, -y, -z),
        }
    }
}

/// The rotation from body to world in the given axes, as the one from FRD to NED.
pub fn attitude_to_ned(world: WorldFrame, body: BodyFrame, rotation: Attitude) -> Attitude {
    let rotation = world.half_turn().map_or(rotation, |half_turn| half_turn.compose(rotation));
    match body {
        BodyFrame::Frd => rotation,
        BodyFrame::Flu => rotation.compose(HALF_TURN_X.inverse()),
    }
    .normalized()
}

//! The box that bounds a flight.

use vehicle::frame::Ned;

/// A box aligned with the world's axes, which the vehicle's position must not leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightBox {
    /// Least north, east and down, m.
    pub lower: Ned,
    /// Greatest north, east and down, m.
    pub upper: Ned,
}

impl FlightBox {
    /// Least and greatest value along each axis, m.
    pub(super) fn ranges(&self) -> [[f64; 2]; 3] {
        let (lower, upper) = (self.lower.to_array(), self.upper.to_array());
        std::array::from_fn(|axis| [lower[axis], upper[axis]])
    }

    /// Distance of a position beyond the farthest of the faces that it is beyond, m; negative
    /// inside.
    pub(super) fn outside_m(&self, position: Ned) -> f64 {
        let beyond = |off: Ned| off.to_array().into_iter().fold(f64::MIN, f64::max);
        beyond(self.lower - position).max(beyond(position - self.upper))
    }
}

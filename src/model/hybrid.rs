//! Physics plus a network on its residual.

use super::learned::NetworkModel;
use super::physics::PhysicsModel;
use super::{ACCELERATIONS, Jacobian, Model, Point};

/// The sum of two models (Bansal et al. 2016, remark 5).
#[derive(Clone, Debug)]
pub struct Hybrid {
    physics: PhysicsModel,
    residual: NetworkModel,
}

impl Hybrid {
    /// `physics`, corrected by `residual`, which was trained on the residual of `physics`.
    pub fn new(physics: PhysicsModel, residual: NetworkModel) -> Self {
        Self { physics, residual }
    }
}

impl Model for Hybrid {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        let (physics, residual) = (self.physics.accelerations(at), self.residual.accelerations(at));
        std::array::from_fn(|i| physics[i] + residual[i])
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (mut value, mut jacobian) = self.physics.linearize(at);
        let (correction, slope) = self.residual.linearize(at);
        for row in 0..ACCELERATIONS {
            value[row] += correction[row];
            for (sum, term) in jacobian[row].iter_mut().zip(slope[row]) {
                *sum += term;
            }
        }
        (value, jacobian)
    }
}

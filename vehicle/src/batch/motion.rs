//! A block of vehicles: each lane's numbers, and the model that all lanes share.

use super::lane::{Lane, Real};
use crate::battery::PowerModel;
use crate::contact::Floor;
use crate::frame::{Attitude, Frd, Ned};
use crate::params::ROTORS;
use crate::physics::Physics;
use crate::rigid_body::State;
use crate::rotor::Lag;

/// Vehicles in a block: four of the widest vectors in single precision.
pub const LANES: usize = 64;

/// One number for each vehicle in a block.
pub type Lanes<F> = [F; LANES];

/// The parts of the model that all vehicles share.
#[derive(Clone, Debug)]
pub struct Model {
    pub physics: Physics,
    pub lag: Lag,
    pub floor: Floor,
    pub floor_down: f64,
    pub power: PowerModel,
}

/// Each lane's inputs, constant over a step.
#[derive(Clone, Debug)]
pub struct Held<F> {
    /// Motor outputs, 0..=1.
    pub outputs: [Lanes<F>; ROTORS],
    /// Velocity of the air in world axes, m/s.
    pub air_velocity: [Lanes<F>; 3],
    /// Factor of the pack's voltage on thrust and squared rotor speed.
    pub voltage_factor: Lanes<F>,
    /// The pack's terminal voltage, V.
    pub voltage: Lanes<F>,
    /// Time since the start, s.
    pub time: f64,
}

/// The lanes' states, which the equations of motion advance.
#[derive(Clone, Debug)]
pub struct Motion<F> {
    pub position: [Lanes<F>; 3],
    pub velocity: [Lanes<F>; 3],
    pub attitude: [Lanes<F>; 4],
    pub body_rate: [Lanes<F>; 3],
    pub rotors: [Lanes<F>; ROTORS],
}

impl<F: Real> Motion<F> {
    #[inline(always)]
    pub fn state(&self, lane: usize) -> State<Lane<F>> {
        let [w, x, y, z] = self.attitude.each_ref().map(|values| Lane(values[lane]));
        State {
            position: Ned::from(self.position.each_ref().map(|values| Lane(values[lane]))),
            velocity: Ned::from(self.velocity.each_ref().map(|values| Lane(values[lane]))),
            attitude: Attitude { w, x, y, z },
            body_rate: Frd::from(self.body_rate.each_ref().map(|values| Lane(values[lane]))),
        }
    }

    #[inline(always)]
    pub fn set_state(&mut self, lane: usize, state: &State<Lane<F>>) {
        let Attitude { w, x, y, z } = state.attitude;
        let put = |into: &mut [Lanes<F>], from: &[Lane<F>]| {
            for (values, value) in into.iter_mut().zip(from) {
                values[lane] = value.0;
            }
        };
        put(&mut self.position, &state.position.to_array());
        put(&mut self.velocity, &state.velocity.to_array());
        put(&mut self.attitude, &[w, x, y, z]);
        put(&mut self.body_rate, &state.body_rate.to_array());
    }

    #[inline(always)]
    pub fn rotors(&self, lane: usize) -> [Lane<F>; ROTORS] {
        self.rotors.each_ref().map(|values| Lane(values[lane]))
    }

    #[inline(always)]
    pub fn set_rotors(&mut self, lane: usize, rotors: [Lane<F>; ROTORS]) {
        for (values, value) in self.rotors.iter_mut().zip(rotors) {
            values[lane] = value.0;
        }
    }
}

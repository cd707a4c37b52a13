//! Constant disturbances, and the equilibrium under them.

use vehicle::frame::{Euler, Frd, Heading, Ned};

use crate::control::hover_model::HoverVehicle;
use crate::setpoint::{Reference, Setpoint};

/// Constant disturbances, each bounded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Disturbance {
    /// Velocity of the position less the reported one, m/s.
    pub velocity: Ned,
    /// Horizontal drag over speed and mass, 1/s.
    pub drag_per_s: f64,
    /// Horizontal acceleration fixed in the world, m/s^2: wind.
    pub world: [f64; 2],
    /// Horizontal acceleration in axes that turn with yaw, m/s^2: the attitude estimate's error.
    pub body: [f64; 2],
    /// Acceleration along the body's down axis, m/s^2: a weight or a thrust that differs from the
    /// file's.
    pub along_thrust: f64,
    /// Offset of the attitude from the one sent, rad: moments that the loop's gains yield to.
    pub attitude: [f64; 3],
}

impl Disturbance {
    /// Scales each disturbance by `share`.
    pub fn fade(&mut self, share: f64) {
        self.velocity = self.velocity * share;
        self.drag_per_s *= share;
        self.along_thrust *= share;
        let rest = self.world.iter_mut().chain(&mut self.body).chain(&mut self.attitude);
        rest.for_each(|number| *number *= share);
    }

    /// Whether each is a number below `size` in its unit.
    pub fn is_below(&self, size: f64) -> bool {
        let rest = self.world.iter().chain(&self.body).chain(&self.attitude);
        let mut all = rest.chain([&self.drag_per_s, &self.along_thrust]);
        all.all(|number| number.abs() < size) && self.velocity.norm() < size
    }

    /// How the disturbances shift the reference and input for a vehicle at the heading `yaw` along
    /// `reference`.
    pub fn shift(&self, vehicle: &HoverVehicle, reference: &Reference, yaw: f64) -> Shift {
        let Disturbance {
            velocity,
            drag_per_s,
            world: [north, east],
            body: [front, right],
            along_thrust,
            attitude,
        } = *self;
        let heading = Heading::new(yaw);
        let [vn, ve, _] = reference.velocity.to_array();
        let push = Ned::new(north - drag_per_s * vn, east - drag_per_s * ve, 0.0);
        let [ahead, aside, _] = heading.to_level(push);
        let (ahead, aside) = (ahead + front, aside + right);
        // Nose up pushes back, right side down pushes right.
        let gravity = vehicle.gravity;
        let (roll, pitch) = ((-aside / gravity).atan(), (ahead / gravity).atan());
        // A tilted thrust must carry the same weight.
        let tilted_n =
            reference.feedforward.thrust_n * ((ahead.hypot(aside) / gravity).hypot(1.0) - 1.0);
        // Drag turns with the velocity; what is fixed in the world is not fed forward as a body
        // rate.
        let thrust = reference.feedforward.thrust_n / vehicle.mass_kg;
        let lift = reference.attitude.attitude().to_world(Frd::new(0.0, 0.0, -thrust));
        let [more_ahead, more_aside, _] = heading.to_level(lift * -drag_per_s);
        Shift {
            velocity: -velocity,
            attitude: Euler::new(roll, pitch, 0.0),
            input: Setpoint {
                thrust_n: vehicle.mass_kg * along_thrust + tilted_n,
                attitude: Euler::new(roll - attitude[0], pitch - attitude[1], -attitude[2]),
                body_rate: Frd::new(-more_aside / gravity, more_ahead / gravity, 0.0),
            },
        }
    }
}

/// The offset of an equilibrium from the undisturbed one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// Velocity reported while the position rests, m/s.
    pub velocity: Ned,
    /// Roll, pitch and yaw that compensate the disturbances, rad.
    pub attitude: Euler,
    /// Thrust that compensates them, and the setpoint at which the loop reaches that attitude.
    pub input: Setpoint,
}

//! Contact with the floor: spring, damper and friction at the feet.

use crate::effects::Wrench;
use crate::frame::Frd;
use crate::physics::Constants;
use crate::rigid_body::State;

/// Natural frequency of the vehicle on its feet, rad/s; far above flight dynamics.
const FREQUENCY: f64 = 60.0;
/// Bound on the rotational modes, rad/s, even for a vehicle with almost no inertia. A step of 1 ms
/// resolves it.
const FASTEST: f64 = 400.0;
/// Damping ratio, high enough to suppress bouncing.
const DAMPING_RATIO: f64 = 0.7;
/// Coulomb friction coefficient.
const FRICTION: f64 = 0.6;

/// Margin for what acceleration adds to the travel within a step, m.
const MARGIN: f64 = 1e-3;

/// A flat floor; the vehicle has a foot below each rotor.
///
/// A spring and damper push a foot out of the floor and never pull. Friction is viscous up to the
/// Coulomb limit. At rest on four feet, the centre of mass of a symmetric vehicle is exactly at the
/// floor's height.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    down: f64,
    feet: [Frd; 4],
    reach: f64,
    stiffness: f64,
    damping: f64,
}

impl Floor {
    /// A floor at down coordinate `down` (m) for a vehicle; `gravity` is in m/s^2.
    pub fn new(down: f64, constants: &Constants, gravity: f64) -> Self {
        let rotors = &constants.rotors;
        let spread = |arm: fn(f64, f64) -> f64| -> f64 {
            rotors.iter().map(|r| arm(r.x, r.y)).sum::<f64>() / 4.0
        };
        let [ix, iy, iz] = constants.inertia;
        // Effective mass at a foot when the vehicle rotates about an axis instead of heaving.
        let turning = (ix / spread(|_, y| y * y))
            .min(iy / spread(|x, _| x * x))
            .min(iz / spread(|x, y| x * x + y * y));
        let mass = constants.mass;
        let stiff_mass = mass.min(turning * (FASTEST / FREQUENCY).powi(2));
        let damped_mass = mass.min(turning * FASTEST / (DAMPING_RATIO * FREQUENCY));
        let stiffness = 0.25 * stiff_mass * FREQUENCY * FREQUENCY;
        let damping = 0.5 * damped_mass * DAMPING_RATIO * FREQUENCY;
        let rest = 0.25 * constants.mass * gravity / stiffness;
        let feet = rotors.map(|r| Frd::new(r.x, r.y, rest));
        let reach = feet.iter().map(|foot| foot.norm()).fold(0.0, f64::max);
        Self { down, feet, reach, stiffness, damping }
    }

    /// Moves the floor to infinity, out of reach.
    pub fn out_of_reach(self) -> Self {
        Self { down: f64::INFINITY, ..self }
    }

    /// Whether no foot can reach the floor within `time` (s), a few milliseconds.
    #[inline]
    pub fn is_clear(&self, state: &State, time: f64) -> bool {
        self.is_clear_of(state.position.down(), state.velocity.down(), time)
    }

    /// As [`Floor::is_clear`], for a vehicle at `down` (m) that descends at `speed` (m/s).
    #[inline]
    pub fn is_clear_of(&self, down: f64, speed: f64, time: f64) -> bool {
        down + speed.max(0.0) * time + self.reach + MARGIN < self.down
    }

    /// Whether a foot penetrates the floor.
    pub fn touches(&self, state: &State) -> bool {
        !self.is_clear(state, 0.0) && self.feet.iter().any(|foot| self.depth(state, foot) > 0.0)
    }

    fn depth(&self, state: &State, foot: &Frd) -> f64 {
        state.position.down() + state.attitude.to_world(*foot).down() - self.down
    }

    /// Force (N) and moment (N m) of the floor on the body, in body axes.
    pub fn wrench(&self, state: &State) -> Wrench<f64> {
        let mut total = Wrench { force: Frd::zero(), moment: Frd::zero() };
        if self.is_clear(state, 0.0) {
            return total;
        }
        for foot in &self.feet {
            let depth = self.depth(state, foot);
            if depth <= 0.0 {
                continue;
            }
            let velocity = state.velocity + state.attitude.to_world(state.body_rate.cross(*foot));
            let [north, east, down] = velocity.to_array();
            let normal = (self.stiffness * depth + self.damping * down).max(0.0);
            let speed = north.hypot(east);
            let grip = if self.damping * speed > FRICTION * normal {
                FRICTION * normal / speed
            } else {
                self.damping
            };
            let force = [-grip * north, -grip * east, -normal].into();
            let force = state.attitude.to_body(force);
            total.force += force;
            total.moment += foot.cross(force);
        }
        total
    }
}

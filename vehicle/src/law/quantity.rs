//! The quantities that a formula may use.

use super::unit::Unit;
use crate::frame::{Frd, Ned};
use crate::physics::Environment;
use crate::rigid_body::State;
use crate::scalar::Scalar;

/// Speeds are smoothed within this distance of 0, m/s, where their derivatives would not exist.
const SMOOTH_M_S: f64 = 1e-6;

macro_rules! quantities {
    ($($variant:ident $name:literal $unit:ident $about:literal),+ $(,)?) => {
        /// A quantity that a formula may use.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[allow(missing_docs)] // `about` describes each
        pub enum Quantity {
            $($variant),+
        }

        impl Quantity {
            /// Every quantity, in the order of its index.
            pub const ALL: [Quantity; QUANTITIES] = [$(Quantity::$variant),+];

            /// The quantity's name in formulas.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            /// The quantity's unit.
            pub fn unit(self) -> Unit {
                match self { $(Self::$variant => Unit::$unit),+ }
            }

            /// Description for people.
            pub fn about(self) -> &'static str {
                match self { $(Self::$variant => $about),+ }
            }
        }
    };
}

/// Number of quantities.
pub const QUANTITIES: usize = 25;

quantities! {
    AirX "air_x" SPEED "velocity relative to the air along front",
    AirY "air_y" SPEED "velocity relative to the air along right",
    AirZ "air_z" SPEED "velocity relative to the air along down of the body",
    Airspeed "airspeed" SPEED "speed relative to the air",
    AirspeedXy "airspeed_xy" SPEED "speed relative to the air in the plane of the rotors",
    VelocityX "velocity_x" SPEED "velocity over ground along front",
    VelocityY "velocity_y" SPEED "velocity over ground along right",
    VelocityZ "velocity_z" SPEED "velocity over ground along down of the body",
    VelocityNorth "velocity_north" SPEED "velocity north",
    VelocityEast "velocity_east" SPEED "velocity east",
    VelocityDown "velocity_down" SPEED "velocity down",
    RateX "rate_x" RATE "body rate about front",
    RateY "rate_y" RATE "body rate about right",
    RateZ "rate_z" RATE "body rate about down of the body",
    Tilt "tilt" NONE "angle between the body's and the world's down, rad",
    Heading "heading" NONE "heading from north towards east, rad",
    Thrust "thrust" FORCE "the rotors' total thrust before aerodynamic factors",
    RotorSpeed "rotor_speed" NONE "mean rotor speed over the one at hover",
    RotorMomentX "rotor_moment_x" MOMENT "moment of the rotors' thrusts about front",
    RotorMomentY "rotor_moment_y" MOMENT "moment of the rotors' thrusts about right",
    RotorMomentZ "rotor_moment_z" MOMENT "moment of the rotors' drag about down of the body",
    Height "height" LENGTH "height above the floor",
    Voltage "voltage" VOLTAGE "terminal voltage of the pack",
    Charge "voltage_share" NONE "terminal voltage over that of a full pack",
    Time "time" TIME "time since the start",
}

/// The rotors' loads, as inputs of formulas.
#[derive(Clone, Copy, Debug)]
pub struct Rotors<T> {
    /// Total thrust before aerodynamic factors, N.
    pub thrust: T,
    /// Mean rotor speed over the one at hover.
    pub speed_ratio: T,
    /// Moments about front, right and down, N m.
    pub moment: [T; 3],
}

/// A set of quantities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needed(u32);

impl Needed {
    /// Adds a quantity to the set.
    pub fn with(self, quantity: Quantity) -> Self {
        Self(self.0 | 1 << quantity as u32)
    }

    /// The union of two sets.
    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The quantities in the set, in the order of [`Quantity::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Quantity> {
        Quantity::ALL.into_iter().filter(move |quantity| self.has(*quantity))
    }

    /// Whether the set contains `quantity`.
    pub fn has(self, quantity: Quantity) -> bool {
        self.0 & (1 << quantity as u32) != 0
    }

    fn any(self, of: &[Quantity]) -> bool {
        of.iter().any(|quantity| self.has(*quantity))
    }
}

/// Values of the quantities in SI units. Costly ones that are not `needed` may be 0.
pub fn values<T: Scalar>(
    needed: Needed,
    state: &State<T>,
    rotors: &Rotors<T>,
    env: &Environment,
    full_voltage: f64,
) -> [T; QUANTITIES] {
    use Quantity as Q;
    let mut values = [T::default(); QUANTITIES];
    let mut set = |quantity: Q, value: T| {
        if let Some(slot) = values.get_mut(quantity as usize) {
            *slot = value;
        }
    };
    let speed = |squares: T| (squares + SMOOTH_M_S * SMOOTH_M_S).sqrt();
    if needed.any(&[Q::AirX, Q::AirY, Q::AirZ, Q::Airspeed, Q::AirspeedXy]) {
        let relative = state.velocity - env.air_velocity.map(T::from);
        let [x, y, z] = state.attitude.to_body(relative).to_array();
        set(Q::AirX, x);
        set(Q::AirY, y);
        set(Q::AirZ, z);
        let flat = x * x + y * y;
        set(Q::Airspeed, speed(flat + z * z));
        set(Q::AirspeedXy, speed(flat));
    }
    if needed.any(&[Q::VelocityX, Q::VelocityY, Q::VelocityZ]) {
        let [x, y, z] = state.attitude.to_body(state.velocity).to_array();
        set(Q::VelocityX, x);
        set(Q::VelocityY, y);
        set(Q::VelocityZ, z);
    }
    let [north, east, down] = state.velocity.to_array();
    set(Q::VelocityNorth, north);
    set(Q::VelocityEast, east);
    set(Q::VelocityDown, down);
    let [p, q, r] = state.body_rate.to_array();
    set(Q::RateX, p);
    set(Q::RateY, q);
    set(Q::RateZ, r);
    let (zero, one) = (T::default(), T::from(1.0));
    if needed.has(Q::Tilt) {
        let axis: Ned<T> = state.attitude.to_world(Frd::new(zero, zero, one));
        let [x, y, z] = axis.to_array();
        set(Q::Tilt, (x * x + y * y + 1e-18).sqrt().atan2(z));
    }
    if needed.has(Q::Heading) {
        let axis: Ned<T> = state.attitude.to_world(Frd::new(one, zero, zero));
        let [x, y, _] = axis.to_array();
        // With the nose straight up, the heading is undefined.
        let is_flat = (x * x + y * y).is_above(1e-18);
        set(Q::Heading, if is_flat { y.atan2(x) } else { zero });
    }
    set(Q::Thrust, rotors.thrust);
    set(Q::RotorSpeed, rotors.speed_ratio);
    let [roll, pitch, yaw] = rotors.moment;
    set(Q::RotorMomentX, roll);
    set(Q::RotorMomentY, pitch);
    set(Q::RotorMomentZ, yaw);
    set(Q::Height, -state.position.down() + env.floor);
    set(Q::Voltage, T::from(env.voltage));
    set(Q::Charge, T::from(env.voltage / full_voltage));
    set(Q::Time, T::from(env.time));
    values
}
